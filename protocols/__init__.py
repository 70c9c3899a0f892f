"""Training and test captures: scikit-learn splitters over captures.

What the harness may ask of one stands in `bench.plan.splits`.
"""

PARTS = {
    "loso": "protocols.subjects:LOSO",
    "groupkfold": "protocols.subjects:SubjectKFold",
    "challenge": "protocols.challenge:Challenge",
    "personal": "protocols.personal:Personal",
    "transfer": "protocols.transfer:Transfer",
    "kfold": "protocols.captures:CaptureKFold",
    "holdout": "protocols.captures:Holdout",
}
