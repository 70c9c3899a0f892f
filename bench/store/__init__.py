"""Where runs are stored: MLflow, its SQLite file, and tables in parquet."""
