"""The execution of plans: the loop, its workers, what a fold does, circumstances, saved systems."""
