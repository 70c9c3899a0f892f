"""A fitted system as C99: what of it is needed (`tables`), and the files that hold it (`write`)."""
