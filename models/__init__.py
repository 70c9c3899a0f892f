"""The recognisers, one file per system; the folder is imported as `bench.models`.

Parts are imported when they are used. The first ones work on any feature set; the others are
complete published systems.
"""

from bench.features import HAART_NOTE

PARTS = {
    "bayes": "bench.models.classic.bayes:bayes",
    "tree": "bench.models.classic.tree:tree",
    "lda": "bench.models.classic.lda:lda",
    "svm": "bench.models.classic.svm:svm",
    "mlp": "bench.models.classic.mlp:mlp",
    "perceptron": "bench.models.classic.perceptron:perceptron",
    "softmax": "bench.models.classic.softmax:softmax",
    "rf": "bench.models.classic.rf:rf",
    "et": "bench.models.classic.rf:et",
    "boost": "bench.models.classic.boost:boost",
    "xgb": "bench.models.classic.xgb:xgb",
    "auto": "bench.models.search.auto:Auto",
    "cnn85": "bench.models.nets.cnn85:CNN85",
    "jung2014_bayes": "bench.models.classic.jung2014:jung2014_bayes",
    "jung2014_svm": "bench.models.classic.jung2014:jung2014_svm",
    "wingerden2014_mlp": "bench.models.classic.wingerden2014:wingerden2014_mlp",
    "balli2015_rf": "bench.models.classic.balli2015:balli2015_rf",
    "gaus2015_rf": "bench.models.classic.gaus2015:gaus2015_rf",
    "gaus2015_boost": "bench.models.classic.gaus2015:gaus2015_boost",
    "hughes2015_softmax": "bench.models.classic.hughes2015:hughes2015_softmax",
    "ta2015_rf": "bench.models.classic.ta2015:ta2015_rf",
    "ta2015_svm": "bench.models.classic.ta2015:ta2015_svm",
    "jung2017_bayes": "bench.models.classic.jung2017:jung2017_bayes",
    "jung2017_tree": "bench.models.classic.jung2017:jung2017_tree",
    "jung2017_svm_linear": "bench.models.classic.jung2017:jung2017_svm_linear",
    "jung2017_svm_rbf": "bench.models.classic.jung2017:jung2017_svm_rbf",
    "jung2017_nn": "bench.models.classic.jung2017:jung2017_nn",
    "zhou2016_3dcnn": "bench.models.nets.zhou2016:Zhou2016CNN3D",
    "zhou2016_2dcnn": "bench.models.nets.zhou2016:Zhou2016CNN2D",
    "zhou2016_lrcn": "bench.models.nets.zhou2016:Zhou2016LRCN",
    "zhou2016_gm_lstm": "bench.models.nets.zhou2016:Zhou2016GMLSTM",
    "hughes2017_cnn": "bench.models.nets.hughes2017:Hughes2017CNN",
    "hughes2017_cnn_rnn": "bench.models.nets.hughes2017:Hughes2017CNNRNN",
    "hughes2017_ae_rnn": "bench.models.nets.hughes2017:Hughes2017AERNN",
    "ren2023_transformer": "bench.models.nets.ren2023:Ren2023Transformer",
    "rocket": "bench.models.rocket:Rocket",
    "touchnet": "bench.models.nets.touchnet:TouchNet",
    "reflex": "bench.models.reflex:Reflex",
}
DESIGNED_ON = dict.fromkeys(("reflex", "rocket", "touchnet"), ("haart", HAART_NOTE))
