"""The feature sets, one file each; names and where they are made (nothing is imported before it is used)."""

PARTS = {
    "jung28": "features.jung28:Jung28",
    "jung54": "features.jung54:Jung54",
    "wingerden45": "features.wingerden45:Wingerden45",
    "balli": "features.balli:Balli",
    "gaus": "features.gaus:Gaus",
    "hughes36": "features.hughes36:Hughes36",
    "ta273": "features.ta273:Ta273",
    "touch": "features.touch:TouchFeatures",
}
