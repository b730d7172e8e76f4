"""``so101 cell``: what a person is asked and told."""

import json

from click.testing import CliRunner

from so101_motion.cli import main


def test_one_arm_alone_has_nothing_to_find_out(tmp_path):
    path = tmp_path / "cell.json"
    path.write_text(json.dumps({"arms": [{"name": "left"}]}))
    result = CliRunner().invoke(main, ["cell", "calibrate", str(path)])
    assert result.exit_code == 2
    assert "names one arm" in result.output


def test_touches_that_are_all_the_same_are_refused_and_the_file_stays(tmp_path):
    path = tmp_path / "cell.json"
    content = json.dumps(
        {"arms": [{"name": "left"}, {"name": "right", "position_mm": [350, 0, 0]}]}
    )
    path.write_text(content)
    asked = ["cell", "calibrate", str(path), "--touches", "5", "--yes"]
    result = CliRunner().invoke(main, asked, input="\n" * 5)
    assert result.exit_code != 0
    assert "touch 5 of 5" in result.output
    assert path.read_text() == content
