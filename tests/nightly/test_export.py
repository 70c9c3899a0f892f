"""Exported C: what compiles with sanitizers or is fitted for seconds."""

import subprocess

import pytest

from tests.export.compiled import check_agreement, check_bad_input, lacking, made, written

pytestmark = [pytest.mark.nightly, pytest.mark.skipif(bool(lacking("gcc")), reason=lacking("gcc"))]


@pytest.mark.parametrize("compiler", ["gcc", "clang"])
@pytest.mark.parametrize("name", ["reflex", "lda scaled", "bayes", "svm", "rf", "xgb", "hughes2017_cnn"])
def test_bad_input_is_a_code_and_nothing_is_undefined(name, compiler, tmp_path):
    if lacking(compiler):
        pytest.skip(lacking(compiler))
    check_bad_input(name, tmp_path, compiler)


def test_eight_bits_of_reflex_in_python_are_those_of_c():
    check_agreement("reflex", 8)


@pytest.mark.skipif(bool(lacking("make", "awk")), reason=lacking("make", "awk"))
def test_make_check_is_strict_and_quiet(tmp_path):
    folder = written(made("bayes", stopping=True), tmp_path)
    call = ["make", "-C", str(folder), "check", "CC=gcc"]
    done = subprocess.run(call, capture_output=True, text=True, check=True)
    assert "2," in done.stdout and done.stderr == ""
    code, right = (folder / "touch.c").read_text(), "t->total[t->seen] = total;"
    assert right in code
    (folder / "touch.c").write_text(code.replace(right, "t->total[t->seen + LONGEST] = total;"))
    done = subprocess.run(call, capture_output=True, text=True, check=False)
    assert done.returncode and "runtime error" in done.stderr
