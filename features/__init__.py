"""The feature sets, one file each; names and where they are made (nothing is imported before it is used)."""

PARTS = {
    "jung28": "bench.features.jung28:Jung28",
    "jung54": "bench.features.jung54:Jung54",
    "wingerden45": "bench.features.wingerden45:Wingerden45",
    "balli": "bench.features.balli:Balli",
    "gaus": "bench.features.gaus:Gaus",
    "hughes36": "bench.features.hughes36:Hughes36",
    "ta273": "bench.features.ta273:Ta273",
    "touch": "bench.features.touch:TouchFeatures",
}
