"""Results of runs: pure functions of their tables, and the one module that queries MLflow."""
