"""What Dask adds: a key of the commands that make runs."""

from bench.ground.typed import Option

CLUSTER = Option(
    "cluster",
    "text",
    "",
    "Dask scheduler that runs the folds: tcp://HOST:8786 or its file",
    uses="touchbench_dask.cluster:Cluster",
)
