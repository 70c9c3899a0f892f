"""The recognisers: one file per system; names and where they are made (nothing is imported before it is used)."""

MODELS = {
    "bayes": "models.bayes:bayes",
    "svm": "models.svm:svm",
    "rf": "models.rf:rf",
    "xgb": "models.xgb:xgb",
    "cnn85": "models.cnn85:CNN85",
}
