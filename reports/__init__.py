"""Tables and figures, made from the store and the published numbers; imported as `bench.reports`."""
