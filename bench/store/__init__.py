"""The store of runs: MLflow, its SQLite file, and tables of runs as parquet."""
