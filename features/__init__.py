"""Feature sets, one file each, imported as ``bench.features``.

`PARTS` maps their names to their classes, which are imported when they are used.
"""

PARTS = {
    "jung28": "bench.features.jung28:Jung28",
    "jung54": "bench.features.jung54:Jung54",
    "wingerden45": "bench.features.wingerden45:Wingerden45",
    "balli": "bench.features.balli:Balli",
    "gaus": "bench.features.gaus:Gaus",
    "hughes36": "bench.features.hughes36:Hughes36",
    "ta273": "bench.features.ta273:Ta273",
    "touch": "bench.features.touch:TouchFeatures",
    "touch_profiles": "bench.features.touch_profiles:TouchProfiles",
}
# Parts that were designed on a corpus: the corpus, and a note for tables of results on it
HAART_NOTE = (
    "The systems reflex, touchnet and rocket and the features touch were designed on seven of "
    "HAART's ten people, the training subjects of its challenge split. "
    "LOSO tests on these seven, too."
)
PROFILES_NOTE = (
    "The features touch_profiles were designed on all ten people of HAART. LOSO tests on them, too."
)
DESIGNED_ON = {"touch": ("haart", HAART_NOTE), "touch_profiles": ("haart", PROFILES_NOTE)}
