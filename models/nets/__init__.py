"""Networks: one training loop, windows, checkpoints, and one file per paper."""
