"""The pages of docs/ and their examples: how they are found and run, and that the site can be built from them."""

import json
import os
import subprocess
import sys
from importlib.util import find_spec
from pathlib import Path

import pytest

ROOT = Path(__file__).parent.parent
TOOLS = ROOT / "docs" / "tools"
PAGES = sorted((ROOT / "docs").rglob("*.md"))

sys.path.insert(0, str(TOOLS))
import examples  # noqa: E402

sys.path.remove(str(TOOLS))

PAGE = """
Text.

```sh
echo one; echo aside >&2
```

<!-- output -->

<!-- not run: it would end the world -->
```sh
exit 3
```

<!-- needs: nothing_of_that_name sh -->
```python
raise SystemExit(3)
```

```python
# mine.py
TWO = 2
```

```sh
python -c 'import mine; print(mine.TWO)'; pwd
```

<!-- output: last 1 lines -->
"""


def test_blocks_run_in_order_in_one_folder_and_those_left_out_do_not():
    found = examples.blocks(PAGE)
    assert [b.left_out for b in found] == ["", "it would end the world", "needs nothing_of_that_name", "", ""]
    assert [b.shown for b in found] == [True, False, False, False, True]
    assert (found[-1].end, found[-1].lines) == ("last", 1)
    assert examples.outputs(PAGE) == ["one\n", "", "", "", "2\n/home/you\n"]
    assert not Path("mine.py").exists()


@pytest.mark.parametrize(
    "block", ["```sh\nfalse | cat\n```\n", "```python\nassert 1 == 2\n```\n", "```sh\nbench run model=none\n```\n"]
)
def test_a_block_that_fails_is_named(block):
    with pytest.raises(examples.Failed, match=block.splitlines()[1]):
        examples.outputs(f"```sh\ntrue\n```\n\n{block}")


@pytest.mark.live
@pytest.mark.skipif(find_spec("mkdocs") is None, reason="needs the extra docs")
def test_the_site_is_built_with_every_example_run(tmp_path):
    """MkDocs runs examples and notebook; warnings, such as a link to nowhere, are errors."""
    out = tmp_path / "site"
    variables = os.environ | {"PYTHONPATH": str(ROOT)}
    variables.pop("TOUCHBENCH_HOME")
    site = [sys.executable, "-m", "mkdocs", "build", "--strict", "-q", "-d", str(out)]
    done = subprocess.run(site, cwd=ROOT, env=variables, capture_output=True, text=True)
    assert done.returncode == 0, done.stdout + done.stderr
    pages = {page.relative_to(out).as_posix(): page.read_text() for page in out.rglob("*.html")}
    assert {p.relative_to(ROOT / "docs").with_suffix(".html").as_posix() for p in PAGES} < set(pages)
    assert "within one standard error of the best" in pages["index.html"]
    assert "Choose " in pages["walk.html"] and "bench stress [key=value ...]" in pages["commands.html"]
    assert "bench.api.stress" in pages["api.html"]
    loaded = [page for page, text in pages.items() if 'src="http' in text or 'rel="stylesheet" href="http' in text]
    assert not loaded, "pages that load something from elsewhere"
    book = json.loads((ROOT / "docs" / "walk.ipynb").read_text())
    assert not any(cell.get("outputs") for cell in book["cells"]), "the notebook is stored without output"
