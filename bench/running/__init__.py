"""The execution of plans: one loop for every kind of run, a file for each kind, workers, faults and sizes."""
