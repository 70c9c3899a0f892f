"""Tables and figures, made from the store and published numbers; imported as `bench.reports`."""
