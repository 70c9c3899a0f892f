"""Circumstances, a file each: changes under which a fitted system predicts test captures again."""

PARTS = {  # by their key of bench run
    "after": "bench.running.circumstances.instants:Instants",
    "under": "bench.running.circumstances.faults:Faults",
    "train_subjects": "bench.running.circumstances.subjects:Subjects",
}
