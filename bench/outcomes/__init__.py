"""What came out of runs: pure functions of their tables, and the one place that asks MLflow."""
