"""Values of runs that both halves use: results, scores, intervals, measures and their tables."""
