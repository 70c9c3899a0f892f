"""Exported C that watches for minutes and hours."""

import numpy as np
import pytest

from addons.chip.tests.compiled import lacking
from addons.chip.tests.test_watch import Watched, check_equal, check_silence, events_of, recordings, reports, watching

pytestmark = [pytest.mark.nightly, pytest.mark.skipif(bool(lacking("gcc")), reason=lacking("gcc"))]


def test_ten_minutes_of_silence_and_an_hour_of_touch(tmp_path):
    recogniser, (_, streams) = watching("reflex"), recordings()
    hour = np.concatenate([*streams.corpus] * 20)[: round(3600 * recogniser.rate_hz)]
    assert len(hour) == 3600 * recogniser.rate_hz
    watched = Watched(recogniser, tmp_path)
    check_equal(events_of(watched.start()(hour), recogniser.classes), reports(recogniser, hour), wrong=0.02)
    check_silence(watched, recogniser, 600, hour)
