import json

import numpy as np
import pytest
from harness.lerobot_data import late, swing, write_data_set


@pytest.fixture
def check(so101):
    return lambda *words: so101("dataset check", *words)


def with_a_jump(root):
    action = swing()
    action[40:, 0] += 60.0
    return write_data_set(root, [swing(), (action, late(swing()))])


def test_a_clean_data_set_is_said_to_be_clean(check, tmp_path):
    root = write_data_set(tmp_path / "set", [swing()])
    result = check(root, "--units", "model")
    assert result.exit_code == 0, result.output
    assert "1 episode, 90 frames at 30 a second" in result.stdout
    assert "joints lag by 100 ms" in result.stdout
    assert "nothing wrong was found" in result.stdout


def test_what_is_wrong_is_listed_for_people_and_programs_and_is_an_exit_code(check, tmp_path):
    asked = with_a_jump(tmp_path / "set"), "--units", "model"
    result = check(*asked, "--worst", "1")
    assert result.exit_code == 6
    assert "1 x jump" in result.stdout
    assert "episode    1,    1.30 s  action: shoulder_pan jumps by 60" in result.stdout
    assert "deg/s" in check(*asked, "--speed", "20").stdout
    content = json.loads(check(*asked, "--json").stdout)
    assert content["schema"] == "so101/dataset-check/1"
    assert content["counts"]["jump"] == 1
    assert content["moments"][0]["what"] == "shoulder_pan"
    assert content["differences"]["lag_s"] == 0.1


def test_the_report_is_one_file_that_loads_nothing(check, tmp_path):
    root = with_a_jump(tmp_path / "<b>set")
    file = tmp_path / "report.html"
    result = check(root, "--units", "model", "--html", file)
    assert result.exit_code == 6
    text = file.read_text()
    assert "action: shoulder_pan jumps by 60" in text
    assert text.count("<polyline") >= 2
    assert "&lt;b&gt;set" in text
    for loads in ("http", "src=", "href=", "@import", "url(", "<script", "<b>"):
        assert loads not in text


def test_a_report_draws_what_is_partly_unknown(check, tmp_path):
    action = swing()
    action[::7] = np.nan
    root = write_data_set(tmp_path / "set", [action, np.full((1, 6), np.nan)])
    check(root, "--html", tmp_path / "report.html")
    assert "nan" not in (tmp_path / "report.html").read_text().lower().replace("<body", "")
