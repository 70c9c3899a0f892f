"""A fitted system as C99: its numbers (`tables`), and the files that hold them (`write`)."""
