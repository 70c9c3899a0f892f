"""Room of results: they are loaded from the store, compared, chosen among and checked."""
