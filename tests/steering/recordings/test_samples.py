"""Recordings of hrt, and what holds for every kind of recording."""

from __future__ import annotations

import json
import math
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from recording_files import put_labels, put_picture, put_text, put_tub, tub_record

from hrt_cli.errors import ArgumentError, InputError
from hrt_cli.steering.recordings.samples import Samples, check_varied, read_samples


def labels(folder: Path, text: str) -> Path:
    put_text(folder / "labels.csv", text)
    return folder


class TestLabels:
    def test_columns_in_any_order(self, tmp_path: Path) -> None:
        text = "goal_deg,session,pitch,yaw,image\n-90,b,0.5,-1,x/1.jpg\n180,a,-0.25,0.5,2.jpg\n0, b ,0,1, 3.jpg \n"
        found = read_samples([labels(tmp_path / "drive", text)])
        assert found.outputs == ("yaw", "pitch")
        np.testing.assert_array_equal(found.steering, np.float32([[-1, 0.5], [0.5, -0.25], [1, 0]]))
        np.testing.assert_allclose(found.goal, [-math.pi / 2, math.pi, 0], rtol=1e-7)
        assert found.goal is not None
        assert (found.steering.dtype, found.goal.dtype, found.session.dtype) == (np.float32, np.float32, np.int32)
        assert found.paths == tuple(tmp_path / "drive" / name for name in ("x/1.jpg", "2.jpg", "3.jpg"))
        assert [found.sessions[each] for each in found.session] == ["drive/b", "drive/a", "drive/b"]
        assert (found.skipped, found.files) == (0, (tmp_path / "drive" / "labels.csv",))

    def test_yaw_alone(self, tmp_path: Path) -> None:
        found = read_samples([labels(tmp_path / "d", "image,yaw\n1.jpg,0.1\n2.jpg,-0.1\n")])
        assert (found.outputs, found.goal, found.sessions) == (("yaw",), None, ("d",))

    @pytest.mark.parametrize(
        "text", ["\ufeffimage,yaw\n1.jpg,0.5\n", "image,yaw\r\n1.jpg,0.5\r\n\r\n", "image,yaw\r1.jpg,0.5\r"]
    )
    def test_byte_order_mark_and_ends_of_line(self, text: str, tmp_path: Path) -> None:
        found = read_samples([labels(tmp_path, text)])
        assert found.steering.tolist() == [[0.5]]
        assert found.paths == (tmp_path / "1.jpg",)

    def test_a_name_in_quotes(self, tmp_path: Path) -> None:
        assert read_samples([labels(tmp_path, 'image,yaw\n"a,b.jpg",0.5\n')]).paths == (tmp_path / "a,b.jpg",)

    @pytest.mark.parametrize(
        ("row", "problem"),
        [
            ("2.jpg,nan", "yaw is 'nan', not a finite number"),
            ("2.jpg,inf", "not a finite number"),
            ("2.jpg,1e999", "not a finite number"),
            ("2.jpg,1.2", "yaw is 1.2, outside [-1, 1]"),
            ("2.jpg,-1.001", "outside [-1, 1]"),
            ("2.jpg,", "yaw is '', not a finite number"),
            ("2.jpg,left", "yaw is 'left'"),
            ("2.jpg,0_1", "yaw is '0_1'"),
            ("2.jpg,١", "not a finite number"),
            ("2.jpg,0,1", "has 3 fields, and the first line names 2"),
            ("2.jpg", "has 1 fields"),
            (",0.5", "names no image"),
            ("1.jpg,0.5", "names the image 1.jpg, which 2 rows name"),
            ("./1.jpg,0", "which 2 rows name"),
            ("/etc/2.jpg,0.5", "an absolute path"),
            ("C:\\2.jpg,0.5", "an absolute path"),
            ("../2.jpg,0.5", "lies outside the folder"),
            ("a/../../2.jpg,0.5", "lies outside the folder"),
            ("..,0.5", "lies outside the folder"),
            ("link.jpg,0.5", "lies outside the folder"),
            ("linked/2.jpg,0.5", "lies outside the folder"),
            ("\0.jpg,0.5", "names no image"),
            ('"2.jpg,0.5', "is not CSV"),
            (f"{'9' * 20_000}.jpg,0.5", "is longer than"),
        ],
    )  # fmt: skip
    def test_a_malformed_row(self, row: str, problem: str, tmp_path: Path) -> None:
        folder = tmp_path / "d"
        folder.mkdir()
        (folder / "link.jpg").symlink_to(put_picture(tmp_path / "outside" / "2.jpg"))
        (folder / "linked").symlink_to(tmp_path / "outside")
        labels(folder, f"image,yaw\n1.jpg,0.5\n{row}\n3.jpg,0.25\n4.jpg,0\n")
        line = 2 if "2 rows" in problem else 3
        with pytest.raises(InputError) as refused:
            read_samples([folder])
        assert f"{folder / 'labels.csv'}: line {line}: " in str(refused.value)
        assert problem in str(refused.value)
        assert "--skip-bad" in str(refused.value)
        notes: list[str] = []
        found = read_samples([folder], skip_bad=True, note=notes.append)
        bad = 2 if "2 rows" in problem else 1
        assert (found.skipped, len(found.paths), len(notes)) == (bad, 4 - bad, bad)
        assert problem in notes[0]

    def test_a_link_inside_and_dots_inside(self, tmp_path: Path) -> None:
        put_picture(tmp_path / "a" / "1.jpg")
        (tmp_path / "link.jpg").symlink_to(tmp_path / "a" / "1.jpg")
        assert len(read_samples([labels(tmp_path, "image,yaw\nlink.jpg,0\na/../2.jpg,0.1\n")]).paths) == 2
        with pytest.raises(InputError, match="which 2 rows name"):
            read_samples([labels(tmp_path, "image,yaw\nlink.jpg,0\na/1.jpg,0.1\n")])

    def test_a_last_row_without_its_end(self, tmp_path: Path) -> None:
        """-0.7342 cut after the point is 0: the missing end of line is the only sign."""
        folder = labels(tmp_path, "image,yaw\n1.jpg,0.5\n2.jpg,-0.")
        with pytest.raises(InputError, match="line 3: has no end of line"):
            read_samples([folder])
        assert read_samples([folder], skip_bad=True).steering.tolist() == [[0.5]]

    @pytest.mark.parametrize(
        ("text", "problem"),
        [
            ("", "is empty"),
            ("\n \n", "is empty"),
            ("image,yaw\n", "holds no frames"),
            ("image,pitch\n1.jpg,0\n", "has no column yaw"),
            ("1.jpg,0.5\n2.jpg,0.5\n", "has no column image"),
            ("image,yaw,speed\n1.jpg,0,0\n", "unknown column 'speed'"),
            ("image,yaw,yaw\n1.jpg,0,0\n", "names a column twice"),
            ("image,yaw", "no end of line"),
            ("image,yaw,session\n1.jpg,0,\n", "line 2: names no session"),
            ("image,yaw,goal_deg\n1.jpg,0,181\n", "line 2: goal_deg is 181, outside"),
            ("image,yaw,goal_deg\n1.jpg,0,\n", "line 2: goal_deg is ''"),
            ("image,yaw,pitch\n1.jpg,0,-2\n", "line 2: pitch is -2, outside"),
        ],
    )
    def test_refused(self, text: str, problem: str, tmp_path: Path) -> None:
        with pytest.raises(InputError, match=problem.replace("(", r"\(")) as refused:
            read_samples([labels(tmp_path, text)])
        assert refused.value.path == str(tmp_path / "labels.csv")

    def test_not_text(self, tmp_path: Path) -> None:
        (tmp_path / "labels.csv").write_bytes(b"\x80\x04\x95pickle")
        with pytest.raises(InputError, match="is not a UTF-8 text file"):
            read_samples([tmp_path])

    def test_many_malformed_rows_are_counted(self, tmp_path: Path) -> None:
        rows = [f"{n}.jpg,{'nan' if n % 2 else 0.5}" for n in range(20)]
        folder = labels(tmp_path, "\n".join(["image,yaw", *rows, ""]))
        with pytest.raises(InputError, match="line 3: yaw is 'nan', not a finite number; 10 rows are malformed in all"):
            read_samples([folder])
        notes: list[str] = []
        assert read_samples([folder], skip_bad=True, note=notes.append).skipped == 10
        assert len(notes) == 4
        assert "7 more rows" in notes[-1]

    def test_all_malformed(self, tmp_path: Path) -> None:
        with pytest.raises(InputError, match="holds no frame whose row is well formed"):
            read_samples([labels(tmp_path, "image,yaw\n1.jpg,nan\n")], skip_bad=True)

    def test_a_frame_that_is_left_out_leaves_a_gap_in_time(self, tmp_path: Path) -> None:
        found = read_samples([labels(tmp_path, "image,yaw\n1.jpg,0\n2.jpg,nan\n3.jpg,0\n")], skip_bad=True)
        assert found.moment is not None
        assert np.diff(found.moment).tolist() == [2]


class TestFolders:
    def test_sessions_of_different_folders_stay_apart(self, tmp_path: Path) -> None:
        text = "image,yaw,session\n1.jpg,0,s\n2.jpg,0.5,s\n"
        one, two = labels(tmp_path / "p" / "d", text), labels(tmp_path / "q" / "d", text)
        found = read_samples([one, two])
        assert found.sessions == ("d/s", "d/s (2)")
        assert found.session.tolist() == [0, 0, 1, 1]
        assert len(found.files) == 2

    def test_a_folder_of_recordings(self, tmp_path: Path) -> None:
        labels(tmp_path / "all" / "b", "image,yaw\n1.jpg,0\n")
        labels(tmp_path / "all" / "deep" / "er" / "a", "image,yaw\n1.jpg,0.5\n")
        labels(tmp_path / "all" / ".hidden", "image,yaw\n1.jpg,0.25\n")
        (tmp_path / "all" / "empty").mkdir()
        (tmp_path / "all" / "again").symlink_to("b")
        (tmp_path / "all" / "empty" / "round").symlink_to("..")
        found = read_samples([tmp_path / "all"])
        assert found.sessions == ("all/b", "all/deep/er/a")
        assert found.steering.tolist() == [[0.0], [0.5]]

    def test_no_folders(self) -> None:
        with pytest.raises(ArgumentError, match="no folder"):
            read_samples([])

    def test_what_is_no_recording(self, tmp_path: Path) -> None:
        with pytest.raises(InputError, match="no such folder"):
            read_samples([tmp_path / "absent"])
        with pytest.raises(InputError, match="steering data is a folder"):
            read_samples([put_text(tmp_path / "a.csv", "x")])
        (tmp_path / "empty").mkdir()
        with pytest.raises(InputError, match="holds no steering data that is known"):
            read_samples([tmp_path / "empty"])

    def test_two_kinds_in_one_folder(self, tmp_path: Path) -> None:
        put_labels(tmp_path, [0, 0.5])
        put_text(tmp_path / "driving_log.csv", "x\n")
        with pytest.raises(InputError, match=r"holds both labels\.csv and driving_log\.csv"):
            read_samples([tmp_path])

    def test_the_same_folder_twice(self, tmp_path: Path) -> None:
        labels(tmp_path / "d", "image,yaw\n1.jpg,0\n")
        (tmp_path / "link").symlink_to(tmp_path / "d")
        for twice in (tmp_path / "d", tmp_path / "link", tmp_path):
            with pytest.raises(InputError, match="is given twice"):
                read_samples([tmp_path / "d", twice])

    def test_one_picture_in_two_recordings(self, tmp_path: Path) -> None:
        labels(tmp_path, "image,yaw\nd/1.jpg,0\n")
        labels(tmp_path / "d", "image,yaw\n1.jpg,0\n")
        with pytest.raises(InputError, match="both name"):
            read_samples([tmp_path, tmp_path / "d"])

    @pytest.mark.parametrize("column", ["pitch", "goal_deg"])
    def test_a_column_in_one_and_not_in_another(self, column: str, tmp_path: Path) -> None:
        with_it = labels(tmp_path / "a", f"image,yaw,{column}\n1.jpg,0,0\n")
        without = labels(tmp_path / "b", "image,yaw\n1.jpg,0\n")
        for order in ([with_it, without], [without, with_it]):
            with pytest.raises(InputError) as refused:
                read_samples(order)
            assert str(refused.value).startswith(f"{without / 'labels.csv'}: has no {column}")
            assert str(with_it / "labels.csv") in str(refused.value)

    def test_several_kinds_together(self, tmp_path: Path) -> None:
        put_labels(tmp_path / "a", [0, 0.5])
        put_tub(tmp_path / "b", [[tub_record(0, -0.5)]])
        assert read_samples([tmp_path]).steering.tolist() == [[0.0], [0.5], [-0.5]]


class TestTurnCosts:
    def test_read(self, tmp_path: Path) -> None:
        put_labels(tmp_path, [0, 0.5], goals_deg=[1, 2], costs_s=["0.50 0 2", "1e1 0.25 0.00"])
        samples = read_samples([tmp_path])
        assert samples.turn_costs_s is not None
        assert samples.turn_costs_s.tolist() == [[0.5, 0.0, 2.0], [10.0, 0.25, 0.0]]
        taken = samples.take([1]).turn_costs_s
        assert taken is not None
        assert taken.tolist() == [[10.0, 0.25, 0.0]]

    @pytest.mark.parametrize(
        ("cell", "problem"),
        [
            ("0 1", "line 3: turn_costs_s has 2 costs, and must have an odd number, in each row as many"),
            ("0 1 2 3 4", "line 3: turn_costs_s has 5 costs"),
            ("", "line 3: turn_costs_s has 0 costs"),
            ("0 nan 1", "line 3: turn_costs_s is 'nan', not a finite number"),
            ("0 -1 1", "line 3: turn_costs_s has a cost outside"),
            ("0 2e6 1", "line 3: turn_costs_s has a cost outside"),
        ],
    )
    def test_malformed(self, cell: str, problem: str, tmp_path: Path) -> None:
        put_labels(tmp_path, [0, 0.5, 0.1], goals_deg=[1, 2, 3], costs_s=["0 1 2", cell, "2 1 0"])
        with pytest.raises(InputError, match=problem):
            read_samples([tmp_path])
        assert len(read_samples([tmp_path], skip_bad=True).paths) == 2

    def test_an_even_number_in_every_row(self, tmp_path: Path) -> None:
        put_labels(tmp_path, [0, 0.5], goals_deg=[1, 2], costs_s=["0 1 2 3"] * 2)
        with pytest.raises(InputError, match="has 4 costs, and must have an odd number"):
            read_samples([tmp_path])

    @pytest.mark.parametrize("other", [None, ["0 1 2 3 4"]])
    def test_not_alike(self, other: list[str] | None, tmp_path: Path) -> None:
        put_labels(tmp_path / "a", [0], goals_deg=[1], costs_s=["0 1 2"])
        put_labels(tmp_path / "b", [0], goals_deg=[1], costs_s=other)
        with pytest.raises(InputError, match=r"turn_costs_s a row, and .* 3: they cannot be learnt together"):
            read_samples([tmp_path / "a", tmp_path / "b"])


class TestOtherGoals:
    def put(self, folder: Path, goals: list[str] | None, costs: list[str] | None) -> None:
        own = {"goals_deg": [1, 2], "costs_s": ["0 1 2"] * 2}
        put_labels(folder, [0, 0.5], other_goals_deg=goals, other_costs_s=costs, **own)

    def test_read(self, tmp_path: Path) -> None:
        self.put(tmp_path, ["90 -180", "0 45.0"], ["0 1 2 3 4 5", "5 4 3 2 1 0"])
        samples = read_samples([tmp_path])
        assert samples.other_goals is not None
        assert samples.other_costs_s is not None
        np.testing.assert_allclose(np.degrees(samples.other_goals), [[90, -180], [0, 45]], rtol=1e-6)
        assert samples.other_costs_s.tolist() == [[[0, 1, 2], [3, 4, 5]], [[5, 4, 3], [2, 1, 0]]]
        taken = samples.take([1])
        assert taken.other_goals is not None
        assert taken.other_costs_s is not None
        assert (taken.other_goals.shape, taken.other_costs_s.tolist()[0][1]) == ((1, 2), [2, 1, 0])

    @pytest.mark.parametrize(
        ("goals", "costs", "problem"),
        [
            ("90", "0 1 2", "has 1 other_goals_deg and 3 other_costs_s"),
            ("90 0 1", "0 1 2 3 4 5 6 7 8", "has 3 other_goals_deg and 9 other_costs_s"),
            ("90 0", "0 1 2 3 4", "has 2 other_goals_deg and 5 other_costs_s"),
            ("", "", "has 0 other_goals_deg and 0 other_costs_s"),
            ("90 181", "0 1 2 3 4 5", "other_goals_deg is 181, outside"),
            ("90 nan", "0 1 2 3 4 5", "other_goals_deg is 'nan', not a finite number"),
            ("90 0", "0 1 2 3 4 -5", "other_costs_s has a cost outside"),
            ("90 0", "0 1 2 3 4 inf", "other_costs_s is 'inf', not a finite number"),
        ],
    )
    def test_malformed(self, goals: str, costs: str, problem: str, tmp_path: Path) -> None:
        # Of two rows that differ the first is taken as right.
        self.put(tmp_path, ["10 20", goals], ["0 1 2 3 4 5", costs])
        with pytest.raises(InputError, match=problem):
            read_samples([tmp_path])
        assert len(read_samples([tmp_path], skip_bad=True).paths) == 1

    @pytest.mark.parametrize("lacking", ["other_costs_s", "other_goals_deg", "turn_costs_s", "goal_deg"])
    def test_one_column_without_the_others(self, lacking: str, tmp_path: Path) -> None:
        columns = {"goals_deg": [1], "costs_s": ["0 1 2"], "other_goals_deg": ["5"], "other_costs_s": ["0 1 2"]}
        name = {"turn_costs_s": "costs_s", "goal_deg": "goals_deg"}.get(lacking, lacking)
        put_labels(tmp_path, [0], **(columns | {name: None}))
        with pytest.raises(InputError, match="needs all of goal_deg, turn_costs_s, other_goals_deg and other_costs_s"):
            read_samples([tmp_path])

    def test_not_alike(self, tmp_path: Path) -> None:
        self.put(tmp_path / "a", ["1", "2"], ["0 1 2"] * 2)
        self.put(tmp_path / "b", None, None)
        with pytest.raises(InputError, match=r"0 other_goals_deg a row, and .* 1: they cannot be learnt together"):
            read_samples([tmp_path / "a", tmp_path / "b"])


class TestLens:
    def put(self, folder: Path, hfov: object = None, kind: str = "hrt-recording") -> Path:
        put_labels(folder, [0, 0.5])
        if hfov is not None:
            (folder / "recording.json").write_text(json.dumps({"format": kind, "lens": {"hfov_deg": hfov}}))
        return folder

    def test_told_where_all_tell_it(self, tmp_path: Path) -> None:
        wide, same, silent = self.put(tmp_path / "a", 100), self.put(tmp_path / "b", 100.0), self.put(tmp_path / "c")
        assert read_samples([wide, same]).hfov_deg == 100.0
        assert read_samples([wide]).take([0]).hfov_deg == 100.0
        assert read_samples([silent]).hfov_deg is None
        assert read_samples([wide, silent]).hfov_deg is None
        assert read_samples([self.put(tmp_path / "d", 60, "another program's")]).hfov_deg is None

    def test_two_lenses(self, tmp_path: Path) -> None:
        folders = [self.put(tmp_path / "a"), self.put(tmp_path / "b", 100), self.put(tmp_path / "c", 75.5)]
        with pytest.raises(
            InputError, match=r"c/labels\.csv: is of a lens 75\.5 degrees wide, and it must be one of 100"
        ):
            read_samples(folders)

    @pytest.mark.parametrize("hfov", [0, 180, -5, "wide", [100], True])
    def test_no_angle(self, hfov: object, tmp_path: Path) -> None:
        with pytest.raises(InputError, match=r"recording\.json: its lens\.hfov_deg is .*, and must be an angle"):
            read_samples([self.put(tmp_path / "a", hfov)])


class TestSamples:
    @given(st.lists(st.integers(0, 4), max_size=8))
    def test_take(self, index: list[int]) -> None:
        samples = five()
        taken = samples.take(np.array(index, np.int64))
        assert [path.name for path in taken.paths] == [str(each) for each in index]
        assert taken.steering[:, 0].tolist() == [each / 8 for each in index]
        assert taken.goal is not None
        assert taken.moment is not None
        assert taken.goal.tolist() == index
        assert taken.moment.tolist() == [10 * each for each in index]
        assert taken.session.tolist() == [each % 2 for each in index]
        assert (taken.sessions, taken.skipped, taken.outputs) == (samples.sessions, 3, ("yaw",))

    def test_take_by_mask(self) -> None:
        assert five().take(np.array([True, False, False, True, False])).steering[:, 0].tolist() == [0, 3 / 8]

    def test_one_class_teaches_nothing(self) -> None:
        samples = five()  # 0 to 0.5
        check_varied(samples, 7)
        with pytest.raises(InputError, match=r"all 2 labels of yaw fall into one class, \+0.00"):
            check_varied(samples.take([0, 1]), 3)

    def test_one_class_of_pitch(self, tmp_path: Path) -> None:
        put_labels(tmp_path, [-1, 1], pitches=[0.3, 0.3])
        with pytest.raises(InputError, match=r"all 2 labels of pitch fall into one class, \+0\.29.*column pitch out"):
            check_varied(read_samples([tmp_path]), 7)


def five() -> Samples:
    return Samples(
        paths=tuple(Path(str(each)) for each in range(5)),
        steering=np.arange(5, dtype=np.float32)[:, None] / 8,
        outputs=("yaw",),
        session=np.array([0, 1, 0, 1, 0], np.int32),
        sessions=("a", "b"),
        goal=np.arange(5, dtype=np.float32),
        skipped=3,
        files=(Path("labels.csv"),),
        moment=np.arange(5, dtype=np.int32) * 10,
    )
