"""The corpora: one file per format that can be imported, and the generator (nothing is imported before it is used)."""

READERS = {
    "cost": "bench.corpora.cost:read",
    "haart": "bench.corpora.haart:read",
    "table": "bench.corpora.table:read",
}
