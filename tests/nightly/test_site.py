"""The site of the documentation with every example of its pages and the notebook run."""

from importlib.util import find_spec

import pytest

from tests.test_readme import check_site

pytestmark = pytest.mark.nightly


@pytest.mark.skipif(find_spec("mkdocs") is None, reason="needs the extra docs")
def test_the_site_is_built_with_every_example_run(tmp_path):
    check_site(tmp_path / "site")
