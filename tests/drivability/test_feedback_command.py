"""`hrt feedback` as a user runs it: keys, exit codes, the table, and what the next stage makes of it."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from bag_files import command, fix, odometry, write
from click.testing import CliRunner, Result
from drives import UTM33, eastward, halves, in_degrees, put_classes, put_log
from hrt_commands.feedback import feedback

from hrt_cli import main as shell
from hrt_cli.drivability.feedback import FeedbackSettings
from hrt_cli.drivability.feedback_stage import learn_scores
from hrt_cli.main import cli


@pytest.fixture
def site(tmp_path: Path) -> tuple[Path, Path, Path]:
    """A class raster, a drive over its first class, and where the scores go."""
    drive = eastward(10, speed_m_s=0.8, commanded_m_s=1.0)
    log = put_log(tmp_path / "drive.jsonl", drive)
    return put_classes(tmp_path / "classes.tif", halves(), names=3), log, tmp_path / "scores.json"


def run(*args: object) -> Result:
    return CliRunner().invoke(cli, ["feedback", *map(str, args)])


def test_json_keys(site: tuple[Path, Path, Path]) -> None:
    classes, log, output = site
    done = run(log, "--classes", classes, "-o", output, "--json")
    assert (done.exit_code, done.stderr) == (0, "")
    found = json.loads(done.stdout)
    assert set(found) == {"output", "up_to_date", "scores", "logs", "evidence_m", "off_map_m", "events", "notes"}
    assert found["output"] == str(output)
    assert list(found["scores"]) == ["0", "1", "2"]
    table = json.loads(output.read_text())
    for k, each in found["scores"].items():
        assert set(each) == {"name", "before", "mean", "sd", "evidence_m"}
        assert each["before"] == 0.5
        assert all(each[key] == table["scores"][k][key] for key in ("name", "mean", "sd", "evidence_m"))
    assert found["scores"]["0"]["mean"] == pytest.approx(9 / 12)
    assert found["evidence_m"] == pytest.approx(10)
    (one,) = found["logs"]
    assert one == {"log": str(log), "sha256": table["logs"][0], "evidence_m": 10.0, "off_map_m": 0.0, "events": 0}
    again = json.loads(run(log, "--classes", classes, "-o", output, "--json").stdout)
    assert again["up_to_date"]
    assert again["scores"] == found["scores"]
    assert again["logs"] is again["evidence_m"] is again["events"] is None


def test_the_table_tells_before_and_after(site: tuple[Path, Path, Path]) -> None:
    classes, log, output = site
    shown = run(log, "--classes", classes, "-o", output).stdout.splitlines()
    assert shown[0] == f"{output}: 10.0 m of evidence and 0 events from 1 log, 0.0 m off the classes"
    assert [line.split() for line in shown[1:3]] == [
        ["class", "name", "mean", "sd", "evidence", "m"],
        ["0", "class", "0", "0.500", "->", "0.750", "0.120", "10.0"],
    ]
    assert len(shown) == 5
    assert run(log, "--classes", classes, "-o", output).stdout.startswith(f"{output}: up to date\n")


def test_an_output_of_other_settings_is_kept(site: tuple[Path, Path, Path], capsys: pytest.CaptureFixture[str]) -> None:
    classes, log, output = site
    run(log, "--classes", classes, "-o", output)
    other = ["feedback", str(log), "--classes", str(classes), "-o", str(output), "--curve", "0:0,0.8:1"]
    assert shell._run(other) == 1
    assert "use --overwrite" in capsys.readouterr().err
    assert shell._run([*other, "--overwrite", "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["scores"]["0"]["mean"] == pytest.approx(11 / 12)


def test_the_scoremap_takes_it(site: tuple[Path, Path, Path]) -> None:
    classes, log, output = site
    run(log, "--classes", classes, "-o", output)
    scoremap = output.with_name("scoremap.tif")
    done = CliRunner().invoke(cli, ["scoremap", str(classes), "-o", str(scoremap), "--scores", str(output), "--json"])
    assert done.exit_code == 0, done.output
    assert json.loads(done.stdout)["mean_score"] == pytest.approx((0.75 + 0.5) / 2, abs=1e-3)
    assert CliRunner().invoke(cli, ["verify", str(output), "--inputs", str(output.parent)]).exit_code == 0


def test_every_kind_of_log_tells_the_same(site: tuple[Path, Path, Path], tmp_path: Path) -> None:
    classes, _, output = site
    drive = eastward(10)
    degrees = in_degrees(drive)
    lines = [f"{each['t']},{each['lon']!r},{each['lat']!r}" for each in degrees]
    (tmp_path / "a.csv").write_text("\n".join(["t,lon,lat", *lines]) + "\n")
    points = "".join(
        f'<trkpt lat="{each["lat"]!r}" lon="{each["lon"]!r}"><time>2024-05-01T12:00:{each["t"]:02.0f}Z</time></trkpt>'
        for each in degrees
    )
    gpx = (
        '<gpx version="1.1" creator="t" xmlns="http://www.topografix.com/GPX/1/1"><trk><trkseg>{}</trkseg></trk></gpx>'
    )
    (tmp_path / "a.gpx").write_text(gpx.format(points))
    # The robot was carried between the fifth and the sixth point: four metres and five are driven.
    cut = points.replace("</trkpt>", "</trkpt></trkseg><trkseg>").split("</trkseg><trkseg>")
    (tmp_path / "cut.gpx").write_text(gpx.format("".join(cut[:5]) + "</trkseg><trkseg>" + "".join(cut[5:])))
    logs = [put_log(tmp_path / "a.jsonl", drive, UTM33), tmp_path / "a.csv", tmp_path / "a.gpx", tmp_path / "cut.gpx"]
    found = []
    for log in logs:
        done = run(log, "--classes", classes, "-o", output, "--commanded", 1, "--overwrite", "--json")
        assert done.exit_code == 0, done.output
        found.append(json.loads(done.stdout)["evidence_m"])
    assert found == pytest.approx([10, 10, 10, 9], rel=1e-4)


def bag(folder: Path, kind: str) -> Path:
    """The drive of `site`, at 0.8 of the commanded speed, as a bag."""
    said = [fix(each["t"], each["lon"], each["lat"]) for each in in_degrees(eastward(10))]
    said += [odometry(k / 2, k / 2, 0, (0.8, 0.0)) for k in range(21)] + [command(k / 2, 1.0) for k in range(21)]
    return write(folder, sorted(said, key=lambda each: each.time_s), kind)


@pytest.mark.parametrize("kind", ["bag", "folder", "mcap folder", "mcap"])
def test_a_bag_is_a_drive_that_counts_once(site: tuple[Path, Path, Path], tmp_path: Path, kind: str) -> None:
    classes, log, output = site
    run(log, "--classes", classes, "-o", output)
    wanted = json.loads(output.read_text())["scores"]
    path = bag(tmp_path / "bags", kind)
    again = ["--classes", classes, "-o", tmp_path / "bag.json", "--json"]
    found = json.loads(run(path, *again).stdout)
    assert found["scores"]["0"]["mean"] == pytest.approx(wanted["0"]["mean"], abs=1e-6)
    assert found["evidence_m"] == pytest.approx(10)
    assert any(note.startswith(f"{path}: takes places from /fix") for note in found["notes"])
    assert json.loads(run(path, *again).stdout)["up_to_date"]
    inputs = json.loads((tmp_path / "bag.json").read_text())["provenance"]["inputs"]
    files = sorted(each.name for each in path.iterdir()) if path.is_dir() else [path.name]
    assert [each["name"] for each in inputs] == ["classes.tif", *files]
    twin = next(each for each in path.iterdir() if each.suffix != ".yaml") if path.is_dir() else path
    for options in ([path, twin], [twin, "--scores", tmp_path / "bag.json"]):
        done = run(*options, "--classes", classes, "-o", tmp_path / "twice.json")
        assert done.exit_code == 1
        assert "twice" in str(done.exception) or "is counted" in str(done.exception)


def test_places_in_the_robots_own_frame_are_refused(site: tuple[Path, Path, Path], tmp_path: Path) -> None:
    classes, _, output = site
    path = write(tmp_path, [odometry(k, k, 0, (1.0, 0.0)) for k in range(9)], "mcap")
    done = run(path, "--classes", classes, "-o", output)
    assert done.exit_code == 1
    assert f"{path}: its places are in the robot's own frame odom, which is not on the map" in str(done.exception)


def test_a_table_that_is_read_anew_is_learnt_from_anew(site: tuple[Path, Path, Path], tmp_path: Path) -> None:
    """Its reader learnt more names; JSON lines and GPX are read as ever, and tables that they made stay up to date."""
    classes, log, output = site
    (tmp_path / "a.csv").write_text("t,x,y\n0,500002,4999995\n9,500009,4999995\n")
    for path, version in ((log, None), (tmp_path / "a.csv", {"csv": 2})):
        assert run(path, "--classes", classes, "-o", output, "--commanded", 1, "--overwrite").exit_code == 0
        parameters = json.loads(output.read_text())["provenance"]["parameters"]
        assert parameters.get("log_readers") == version


def test_the_defaults_are_those_of_the_settings(site: tuple[Path, Path, Path]) -> None:
    classes, log, output = site
    end = {"event": "collision", "heading_deg": 90.0}
    put_log(log, [*eastward(17, speed_m_s=1.0, commanded_m_s=1.0), *eastward(0, east_m=19.5, t0=17.5, **end)])
    command = next(each for each in feedback.params if each.name == "event_weight")
    assert command.default == FeedbackSettings().event_weight_m
    assert run(log, "--classes", classes, "-o", output).exit_code == 0
    learn_scores([log], classes, output.with_name("other.json"), FeedbackSettings())
    assert output.read_bytes() == output.with_name("other.json").read_bytes()
    assert json.loads(output.read_text())["scores"]["1"]["evidence_m"] == pytest.approx(command.default)


def test_notes_go_to_stderr(site: tuple[Path, Path, Path], tmp_path: Path) -> None:
    classes, _, output = site
    log = put_log(tmp_path / "n.jsonl", eastward(10), None)
    done = run(log, "--classes", classes, "-o", output)
    assert [line.split(":")[0] for line in done.stderr.splitlines()] == ["Note", "Note"]
    assert "names no CRS" in done.stderr
    assert "taken as 1 m/s" in done.stderr
    assert run(log, "--classes", classes, "-o", output, "--force", "-q").stderr == ""


@pytest.mark.parametrize(
    ("options", "code", "problem"),
    [
        (["--curve", "0:1,1:0"], 2, "must not fall"),
        (["--commanded", "0"], 2, "too small"),
        (["--forget-m", "0"], 2, "too small"),
        (["--event-weight", "-1"], 2, "too small"),
        (["--robot-radius", "nan"], 2, "not a finite number"),
        (["--scores", "absent.json"], 1, "absent.json: no such file"),
        (["--dsm", "absent.tif"], 1, "absent.tif: no such file"),
        (["absent.jsonl"], 1, "absent.jsonl: no such file"),
    ],
)
def test_what_is_refused(
    site: tuple[Path, Path, Path], capsys: pytest.CaptureFixture[str], options: list[str], code: int, problem: str
) -> None:
    classes, log, output = site
    assert shell._run(["feedback", str(log), "--classes", str(classes), "-o", str(output), *options]) == code
    assert problem in capsys.readouterr().err
    assert not output.exists()
