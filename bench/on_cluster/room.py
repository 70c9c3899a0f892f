"""What a cluster adds: a key of the commands that make runs."""

from bench.options import WORK, Option

CLUSTER = Option(
    "cluster",
    WORK,
    "text",
    "",
    "Dask scheduler that runs the folds: tcp://HOST:8786 or its file",
    uses="bench.on_cluster.cluster:Cluster",
)
