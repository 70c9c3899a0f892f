"""The recognisers: one file per system; names and where they are made (nothing is imported before it is used).

The first ones go with any feature set, the others are published systems as a whole.
"""

MODELS = {
    "bayes": "models.bayes:bayes",
    "tree": "models.tree:tree",
    "svm": "models.svm:svm",
    "mlp": "models.mlp:mlp",
    "softmax": "models.softmax:softmax",
    "rf": "models.rf:rf",
    "et": "models.rf:et",
    "boost": "models.boost:boost",
    "xgb": "models.xgb:xgb",
    "auto": "models.auto:auto",
    "cnn85": "models.cnn85:CNN85",
    "jung2014_bayes": "models.jung2014:jung2014_bayes",
    "jung2014_svm": "models.jung2014:jung2014_svm",
    "wingerden2014_mlp": "models.wingerden2014:wingerden2014_mlp",
    "balli2015_rf": "models.balli2015:balli2015_rf",
    "gaus2015_rf": "models.gaus2015:gaus2015_rf",
    "gaus2015_boost": "models.gaus2015:gaus2015_boost",
    "hughes2015_softmax": "models.hughes2015:hughes2015_softmax",
    "ta2015_rf": "models.ta2015:ta2015_rf",
    "ta2015_svm": "models.ta2015:ta2015_svm",
    "jung2017_bayes": "models.jung2017:jung2017_bayes",
    "jung2017_tree": "models.jung2017:jung2017_tree",
    "jung2017_svm_linear": "models.jung2017:jung2017_svm_linear",
    "jung2017_svm_rbf": "models.jung2017:jung2017_svm_rbf",
    "jung2017_nn": "models.jung2017:jung2017_nn",
}
