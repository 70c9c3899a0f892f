"""Who is trained on and who is tested: scikit-learn splitters over captures.

Every protocol has ``split(X, y, groups)`` over a `Corpus`, ``label(corpus)``, the words that stand in every row of
results, and ``mixes_subjects``, which is true where a test subject's other captures are trained on.
"""

PROTOCOLS = {
    "loso": "protocols.subjects:LOSO",
    "groupkfold": "protocols.subjects:SubjectKFold",
    "challenge": "protocols.challenge:Challenge",
    "kfold": "protocols.captures:CaptureKFold",
    "holdout": "protocols.captures:Holdout",
}
