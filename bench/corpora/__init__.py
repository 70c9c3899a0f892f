"""Corpora: the value, where it is stored, a reader for each format, and the generator.

Nothing is imported before it is used.
"""

PARTS = {
    "cost": "bench.corpora.read.cost:read",
    "cuddlebot": "bench.corpora.read.cuddlebot:read",
    "haart": "bench.corpora.read.haart:read",
    "table": "bench.corpora.read.table:read",
}
