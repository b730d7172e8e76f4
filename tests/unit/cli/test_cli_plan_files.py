from __future__ import annotations

from pathlib import Path

from click.testing import CliRunner, Result

from so101_motion.cli.verbs import main


def plan(*options: str) -> Result:
    return CliRunner().invoke(main, ["plan", "--sim", "--pose", "ready", *options])


def test_a_plan_is_saved_as_a_table_and_as_a_film(tmp_path: Path) -> None:
    table, film = tmp_path / "move.csv", tmp_path / "move.html"
    outcome = plan("--out", str(table), "--html", str(film))
    assert outcome.exit_code == 0, outcome.output
    header, *rows = table.read_text().splitlines()
    assert header.startswith("time_s,shoulder_pan_deg,")
    assert len(rows) > 10
    page = film.read_text()
    assert "Simulated arm" in page
    assert "Peak speed" in page


def test_a_film_that_is_no_html_file_is_refused_in_a_sentence(tmp_path: Path) -> None:
    outcome = plan("--html", str(tmp_path / "move.mp4"))
    assert outcome.exit_code == 2
    assert "must end with .html" in outcome.output
