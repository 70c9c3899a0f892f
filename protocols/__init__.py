"""Training and test captures: scikit-learn splitters over captures.

What the harness may ask of one stands in `bench.plan.splits`.
"""

PARTS = {
    "loso": "bench.protocols.subjects:LOSO",
    "groupkfold": "bench.protocols.subjects:SubjectKFold",
    "challenge": "bench.protocols.challenge:Challenge",
    "personal": "bench.protocols.personal:Personal",
    "transfer": "bench.protocols.transfer:Transfer",
    "kfold": "bench.protocols.captures:CaptureKFold",
    "holdout": "bench.protocols.captures:Holdout",
}
