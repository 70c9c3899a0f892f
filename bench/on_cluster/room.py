"""What the cluster adds to touchbench: as entry points ``touchbench.<group>`` of a package would."""

from bench.options import WORK, Option

ADDS = {
    "options": {"cluster": "bench.on_cluster.room:CLUSTER"},
    "workers": {"cluster": "bench.on_cluster.cluster:Cluster"},
}
CLUSTER = Option("cluster", WORK, "text", "", "Dask scheduler that runs the folds: tcp://HOST:8786 or its file")
