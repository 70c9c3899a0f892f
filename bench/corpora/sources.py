"""Published corpora: where each can be downloaded, and what shows that it is the published one."""

from __future__ import annotations

from dataclasses import dataclass

REPOSITORY = "https://github.com/lauracang/ICMI15"
COMMIT = "80a5c69c6ac9eefa808859b8d4aadfc77c398141"


@dataclass(frozen=True)
class Source:
    """A published corpus that ``bench data get`` downloads and imports.

    Its format (`bench.corpora.PARTS`) has its name, and warns of each deviation from the published
    figures.

    Attributes:
        file: name of the file, as it is published.
        address: where to download it.
        contents: captures, people, sensor.
        size: of the files, in words.
        licence: what its authors state.
        paper: what to cite.
        page: where a person finds the file.
        is_listing: the address has a list of files with their addresses, as Figshare and 4TU have.
        must_accept: the user has to accept the licence.
        digest: of the captures once they are imported, if it is known.
    """

    file: str
    address: str
    contents: str
    size: str
    licence: str
    paper: str
    page: str
    is_listing: bool = False
    must_accept: bool = False
    digest: str = ""


COST = Source(
    "CoST.csv",
    "https://data.4tu.nl/v2/articles/12696869/files",
    "7805 captures of 14 gestures by 31 people, 8x8 on a mannequin's forearm, 135 Hz",
    "about 1.5 million lines of CSV",
    "CC BY-NC-SA 4.0",
    "Jung et al., Automatic recognition of touch gestures in the corpus of social touch, JMUI 2017",
    "https://doi.org/10.4121/uuid:5ef62345-3b3e-479c-8e1d-c922748c9b29",
    is_listing=True,
    must_accept=True,
)
CUDDLEBOT = Source(
    "ICMI15.zip",
    f"{REPOSITORY}/archive/{COMMIT}.zip",
    "902 captures of 7 gestures by 16 people, 10x10 on a furry robot, 54 Hz",
    "232 MB of CSV and other files, packed",
    "none stated by its authors",
    "Cang et al., Different strokes and different folks, ICMI 2015",
    REPOSITORY,
    digest="3b64981c717155af",
)
HAART = Source(
    "HAART DataSet.zip",
    "https://www.cs.ubc.ca/labs/spin/data/HAART%20DataSet.zip",
    "829 captures of 7 gestures by 10 people, 8x8 with four covers on three substrates, 54 Hz",
    "58 MB of CSV, packed",
    "none stated by its authors",
    "Jung et al., Touch challenge '15, ICMI 2015; Cang et al., ICMI 2015",
    "https://www.cs.ubc.ca/labs/spin/data",
)
PARTS = {
    "cost": "bench.corpora.sources:COST",
    "cuddlebot": "bench.corpora.sources:CUDDLEBOT",
    "haart": "bench.corpora.sources:HAART",
}
