"""Values that both halves know: measures, results, scores, intervals, tables."""
