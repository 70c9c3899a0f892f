"""Networks: one training loop, windows, and one file per paper."""
