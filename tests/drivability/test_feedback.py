"""Evidence of drives: hand-computed posteriors, and what they must not depend on."""

from __future__ import annotations

import json
import random
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from affine import Affine
from drives import ORIGIN, PIXEL, UTM33, eastward, halves, in_degrees, put_classes, put_log, xy
from hypothesis import given, settings
from hypothesis import strategies as st
from raster_files import write_raster
from rasterio.warp import calculate_default_transform, reproject, transform

from hrt_cli.artifacts.scores import ClassScore, read_score_table, scores_document
from hrt_cli.artifacts.stage import Existing
from hrt_cli.drivability.episodes import REACH_M
from hrt_cli.drivability.feedback import (
    CONTACT_RADIUS_M,
    SPOT_M,
    UNTRIED_M,
    Curve,
    Evidence,
    FeedbackSettings,
    posterior,
    settled,
    updated,
)
from hrt_cli.drivability.feedback_stage import FeedbackSummary, learn_scores
from hrt_cli.drivability.footprint import new_ahead
from hrt_cli.errors import ArgumentError, HrtError, InputError

HUSKY = Path(__file__).parents[2].parent / "shared" / "data" / "husky" / "husky_gps.csv"
pytestmark = pytest.mark.filterwarnings("ignore:Use `@` matmul:PendingDeprecationWarning")

AGAIN = Existing(overwrite=True, force=True)
EVENT_M = FeedbackSettings().event_weight_m
RADIUS_M = FeedbackSettings().robot_radius_m


@pytest.fixture
def classes(tmp_path: Path) -> Path:
    return put_classes(tmp_path / "classes.tif", halves(), names=3)


def learn(classes: Path, *logs: list[dict[str, Any]] | Path, **options: Any) -> FeedbackSummary:
    """Learn from logs (or their records) beside a class raster."""
    header = options.pop("header", {})
    paths = [
        each if isinstance(each, Path) else put_log(classes.with_name(f"log{index}.jsonl"), each, **header)
        for index, each in enumerate(logs)
    ]
    more = {name: options.pop(name) for name in ("scores_path", "dsm_path", "existing") if name in options}
    return learn_scores(
        paths, classes, classes.with_name("out.json"), FeedbackSettings(**options), **{"existing": AGAIN, **more}
    )


def beta(found: FeedbackSummary, k: int) -> tuple[float, float]:
    return found.after[k].alpha, found.after[k].beta


class TestByHand:
    def test_a_drive_at_a_share_of_the_commanded_speed(self, classes: Path) -> None:
        # 10 s at 0.8 of 1.5 m/s: 15 m commanded, progress 0.8.
        drive = eastward(10, speed=1.2, speed_m_s=1.2, commanded_m_s=1.5)
        found = learn(classes, drive)
        assert beta(found, 0) == pytest.approx((1 + 15 * 0.8, 1 + 15 * 0.2))
        assert found.after[0].evidence_m == pytest.approx(15)
        assert found.after[0].name == "class 0"
        assert found.totals() == {"evidence_m": pytest.approx(15), "off_map_m": 0.0, "events": 0}

    def test_speed_from_places_is_metres_of_ground(self, classes: Path) -> None:
        found = learn(classes, eastward(10, speed=1.2, commanded_m_s=1.5))
        assert beta(found, 0) == pytest.approx((1 + 15 * 0.8, 1 + 15 * 0.2), rel=1e-5)

    def test_two_classes_share_a_drive_by_the_ground_of_each(self, classes: Path) -> None:
        # From 2 m to 32 m at 1 m/s, the border at 20 m; half the speed of the command on the second class.
        drive = eastward(18, speed_m_s=1.0, commanded_m_s=1.0) + eastward(
            20, east_m=20.5, speed=0.5, t0=19, speed_m_s=0.5, commanded_m_s=1.0
        )
        found = learn(classes, drive)
        assert found.after[0].evidence_m + found.after[1].evidence_m == pytest.approx(39)
        assert found.after[1].evidence_m == pytest.approx(20.5, abs=0.3)
        assert found.after[0].mean == pytest.approx(19.4 / 20.4, abs=0.03)
        assert found.after[1].mean == pytest.approx(11.2 / 22.5, abs=0.03)

    def test_a_long_interval_is_shared_along_its_way(self, classes: Path) -> None:
        # One interval of 9 s from 16 m to 25 m: 4 m of class 0, 5 m of class 1; its middle lies on class 1.
        drive = eastward(9, east_m=16, step_s=9, speed_m_s=1.0, commanded_m_s=1.0)
        found = learn(classes, drive)
        assert found.after[0].evidence_m == pytest.approx(4, abs=0.1)
        assert found.after[1].evidence_m == pytest.approx(5, abs=0.1)

    def test_a_stall_weighs_what_was_commanded(self, classes: Path) -> None:
        found = learn(classes, [{**each, **xy(5, 5)} for each in eastward(8, speed_m_s=0.0, commanded_m_s=0.5)])
        assert beta(found, 0) == pytest.approx((1, 1 + 4))

    def test_a_robot_that_is_told_to_stand_says_nothing(self, classes: Path) -> None:
        found = learn(classes, [{**each, **xy(5, 5)} for each in eastward(8, speed_m_s=0.0, commanded_m_s=0.0)])
        assert found.after == found.before
        assert "holds no evidence" in found.notes[0]

    def test_a_robot_that_stands_unbidden_may_have_been_told_to(self, classes: Path) -> None:
        stand = [{"t": 11.0 + t, **xy(12, 5)} for t in range(30)]
        moving, both = learn(classes, eastward(10)), learn(classes, eastward(10) + stand)
        assert moving.after[0].evidence_m == pytest.approx(10, rel=1e-3)
        assert both.after[0].evidence_m == pytest.approx(10, abs=0.6)
        assert both.after[0].mean > 0.88

    def test_a_robot_that_rolls_out_says_nothing(self, classes: Path) -> None:
        drive = [
            {"t": 0.5 * i, **xy(5 + 0.125 * i, 5), "speed_m_s": 0.25, "commanded_m_s": u}
            for i, u in enumerate((1.0, 1.0, 1.0, 0.0, 0.0, 0.0))
        ]
        # A second at 0.25 of 1 m/s, then half a second in which the command falls: at 0.25 of 0.5 m/s on average.
        assert beta(learn(classes, drive), 0) == pytest.approx((1 + 0.25 + 0.125, 1 + 0.75 + 0.125))

    def test_creeping_is_standing_where_no_command_is_logged(self, classes: Path) -> None:
        creep = eastward(20, speed=0.09, speed_m_s=0.09)
        assert learn(classes, creep, commanded_m_s=1.0).totals()["evidence_m"] == 0
        assert learn(classes, creep, commanded_m_s=0.5).totals()["evidence_m"] == pytest.approx(1.8)

    def test_merged_intervals_give_the_same(self, classes: Path) -> None:
        coarse = learn(classes, eastward(10, speed=1.2, commanded_m_s=1.5))
        fine = learn(classes, eastward(10, speed=1.2, step_s=0.1, commanded_m_s=1.5))
        assert beta(fine, 0) == pytest.approx(beta(coarse, 0), rel=1e-6)

    def test_a_gap_is_no_drive(self, classes: Path) -> None:
        drive = eastward(3, speed_m_s=1.0, commanded_m_s=1.0) + eastward(
            3, east_m=9, t0=13.5, speed_m_s=1.0, commanded_m_s=1.0
        )
        assert learn(classes, drive).after[0].evidence_m == pytest.approx(6)
        assert learn(classes, drive, gap_s=11).after[0].evidence_m == pytest.approx(16.5)

    def test_equal_times_divide_nothing_by_zero(self, classes: Path) -> None:
        drive = eastward(10, speed_m_s=1.0, commanded_m_s=1.0)
        twice = sorted([*drive, *drive], key=lambda each: each["t"])
        assert beta(learn(classes, twice), 0) == pytest.approx((11, 1))
        assert learn(classes, [{**each, "t": 0.0} for each in drive]).totals()["evidence_m"] == 0

    def test_one_record_says_nothing(self, classes: Path) -> None:
        assert learn(classes, eastward(0, commanded_m_s=1.0)).totals()["evidence_m"] == 0

    def test_ground_without_a_class_is_told_of(self, classes: Path) -> None:
        found = learn(classes, eastward(10, east_m=-5, speed_m_s=1.0, commanded_m_s=1.0))
        assert found.totals()["off_map_m"] == pytest.approx(5, abs=0.5)
        assert found.totals()["evidence_m"] + found.totals()["off_map_m"] == pytest.approx(10)
        gaps = halves()
        gaps[:, :70] = 255
        found = learn(put_classes(classes, gaps), eastward(10, speed_m_s=1.0, commanded_m_s=1.0))
        assert found.totals()["off_map_m"] == pytest.approx(5, abs=0.5)


class TestCommand:
    def test_the_user_may_say_it(self, classes: Path) -> None:
        found = learn(classes, eastward(10, speed=0.5), commanded_m_s=1.0)
        assert beta(found, 0) == pytest.approx((1 + 5 * 0.5, 1 + 5 * 0.5), rel=1e-3)
        assert found.notes == []

    def test_the_log_comes_before_the_user(self, classes: Path) -> None:
        drive = eastward(10, speed_m_s=1.0, commanded_m_s=1.0)
        assert beta(learn(classes, drive, commanded_m_s=9.0), 0) == pytest.approx((11, 1))

    def test_else_it_is_estimated_aloud(self, classes: Path) -> None:
        drive = eastward(15, speed_m_s=1.0) + eastward(20, east_m=20.5, speed=0.5, t0=15.5, speed_m_s=0.5)
        found = learn(classes, drive)
        assert found.after[0].mean > 0.9
        assert found.after[1].mean == pytest.approx(0.5, abs=0.05)
        assert "taken as 1 m/s" in found.notes[0]

    def test_a_jump_of_the_receiver_is_no_drive(self, classes: Path) -> None:
        drive = eastward(16)
        drive[8] |= xy(2 + 8, 5 - 300)
        found = learn(classes, drive)
        assert "jump" in found.notes[1]
        assert beta(found, 0) == pytest.approx((17, 1), rel=0.01)

    def test_positions_that_jump_for_long_are_left_out(self, classes: Path) -> None:
        aside = [each | {"y": each["y"] - 300} for each in eastward(1, east_m=19, t0=17)]
        found = learn(classes, eastward(16) + aside + eastward(10, east_m=21, t0=19), commanded_m_s=1.0)
        assert "jump" in found.notes[0]
        assert found.totals()["evidence_m"] == pytest.approx(25, abs=4)
        assert found.after[0].mean > 0.9


# East over class 0 to 19.6 m; the border to class 1 is at 20 m, and the robot's hull ends 0.05 m before it.
RUN = eastward(17, east_m=2.6, step_s=0.5, speed_m_s=1.0, commanded_m_s=1.0)
STOP = RUN[-1] | {"event": "collision"}
STANDS = [{**STOP, "t": 17 + 0.5 * i, "speed_m_s": 0.0, "event": None} for i in range(1, 11)]


class TestEvents:
    @staticmethod
    def told(records: list[dict[str, Any]]) -> list[dict[str, Any]]:
        return [{k: v for k, v in each.items() if v is not None} for each in records]

    @pytest.mark.parametrize("heading", [None, 90.0, -270.0])
    @pytest.mark.parametrize(("kind", "share"), [("collision", 1.0), ("stuck", 1.0), ("intervention", 0.5)])
    def test_the_class_ahead_is_blamed(self, classes: Path, heading: float | None, kind: str, share: float) -> None:
        stop = STOP | {"event": kind, "heading_deg": heading}
        found = learn(classes, self.told([*RUN[:-1], stop]))
        assert beta(found, 0) == pytest.approx((18, 1))
        assert beta(found, 1) == pytest.approx((1, 1 + EVENT_M * share))
        assert found.totals()["events"] == 1

    def test_a_heading_counts_before_the_way_that_was_driven(self, classes: Path) -> None:
        stop = STOP | {"heading_deg": 270.0}
        found = learn(classes, [*RUN[:-1], stop])
        assert beta(found, 0) == pytest.approx((18, 1 + EVENT_M))
        assert beta(found, 1) == (1, 1)

    @pytest.mark.parametrize("contact_m", [-0.5 * CONTACT_RADIUS_M, 0.0, RADIUS_M + REACH_M - 0.1])
    def test_only_what_is_new_ahead_is_blamed(self, classes: Path, contact_m: float) -> None:
        # The contact's middle lies before, on and beyond the border; in the end a part of the robot is across it.
        stop = STOP | xy(20.0 + contact_m - RADIUS_M - REACH_M, 5.0)
        found = learn(classes, [*RUN[:-1], stop])
        assert found.after[0].beta == pytest.approx(1, abs=1e-9)
        assert found.after[1].beta == pytest.approx(1 + EVENT_M, abs=1e-9)

    def test_weight_and_radius(self, classes: Path) -> None:
        drive = [*RUN[:-1], STOP]
        assert beta(learn(classes, drive, event_weight_m=3.0), 1) == pytest.approx((1, 4))
        # The ground that stops a small robot ends a pixel before the border; that which stops a larger one does not.
        drive[-1] = STOP | xy(20.0 - 0.1 - (0.05 + REACH_M + CONTACT_RADIUS_M), 5.0) | {"heading_deg": 90.0}
        small = learn(classes, drive, robot_radius_m=0.05)
        assert beta(small, 1) == (1, 1)
        assert small.after[0].beta == pytest.approx(1 + EVENT_M)
        told = learn(classes, drive, header={"robot": {"kind": "ugv", "radius_m": 0.35}}, robot_radius_m=0.05)
        assert beta(told, 1) == pytest.approx((1, 1 + EVENT_M))

    @pytest.mark.parametrize("stuck_at", [None, 5])
    def test_a_standstill_weighs_as_its_event(self, classes: Path, stuck_at: int | None) -> None:
        stands = [dict(each) for each in STANDS]
        if stuck_at is not None:
            stands[stuck_at]["event"] = "stuck"
        stop = STOP | {"speed_m_s": 0.0}
        found = learn(classes, self.told([*RUN[:-1], stop, *stands]))
        # The 5 m commanded while it stood count nothing, and the episode once; half a second slowing down is class 0's.
        assert beta(found, 1) == pytest.approx((1, 1 + EVENT_M))
        assert beta(found, 0) == pytest.approx((1 + 16.75, 1 + 0.25))
        assert found.totals()["events"] == 1
        assert found.totals()["evidence_m"] == pytest.approx(17 + EVENT_M)

    def test_however_long_it_tried(self, classes: Path) -> None:
        stop = STOP | {"speed_m_s": 0.0}
        stands = [{**STANDS[0], "t": 17 + 0.5 * i} for i in range(1, 200)]
        short, long = (learn(classes, self.told([*RUN[:-1], stop, *stands[:n]])) for n in (10, 199))
        assert long.after == short.after
        assert beta(learn(classes, self.told([*RUN[:-1], stop, *stands]), event_weight_m=0.0), 1) == (1, 1)

    def test_a_stop_is_sharp_where_speeds_come_from_places(self, classes: Path) -> None:
        drive = [{k: v for k, v in each.items() if k != "speed_m_s"} for each in (*RUN[:-1], STOP, *STANDS)]
        found = learn(classes, self.told(drive))
        assert beta(found, 0) == pytest.approx((18, 1), abs=0.01)
        assert beta(found, 1) == pytest.approx((1, 1 + EVENT_M), abs=0.01)

    def test_a_standstill_before_it_is_called_stuck_is_part_of_it(self, classes: Path) -> None:
        stop = STOP | {"speed_m_s": 0.0, "event": None}
        stands = [*STANDS[:-1], STANDS[-1] | {"event": "stuck"}]
        found = learn(classes, self.told([*RUN[:-1], stop, *stands]))
        assert found.after[1].beta == pytest.approx(1 + EVENT_M)
        assert found.after[0].beta == pytest.approx(1, abs=0.6)

    def test_standing_for_no_event_is_the_ground_under_the_wheels(self, classes: Path) -> None:
        stop = STOP | {"speed_m_s": 0.0, "event": None}
        found = learn(classes, self.told([*RUN[:-1], stop, *STANDS]))
        assert beta(found, 1) == (1, 1)
        assert found.after[0].beta == pytest.approx(6.25)

    def test_standing_after_a_person_stepped_in_is_not_the_ground_ahead(self, classes: Path) -> None:
        stop = STOP | {"speed_m_s": 0.0, "event": "intervention"}
        found = learn(classes, self.told([*RUN[:-1], stop, *STANDS]))
        assert beta(found, 1) == pytest.approx((1, 1 + EVENT_M / 2))
        assert found.after[0].beta == pytest.approx(6.25)

    @pytest.mark.parametrize(("aside_m", "times"), [(0.0, 1), (2 * SPOT_M, 2)])
    def test_another_collision_counts_again_at_another_spot(self, classes: Path, aside_m: float, times: int) -> None:
        back = [
            {"t": 18.0 + i, **xy(19.6 - d, 5.2 + aside_m * (i > 2)), "speed_m_s": 0.5, "commanded_m_s": 0.5,
             "heading_deg": 90.0}
            for i, d in enumerate((0.5, 1.0, 1.5, 1.0, 0.5, 0.0))
        ]  # fmt: skip
        back[-1]["event"] = "collision"
        found = learn(classes, [*RUN[:-1], STOP | xy(19.6, 5.2) | {"heading_deg": 90.0}, *back])
        assert found.totals()["events"] == 2
        assert beta(found, 1) == pytest.approx((1, 1 + times * EVENT_M))


def hit(east_m: float, south_m: float, event: str = "collision", t: float = 0.0) -> dict[str, Any]:
    """A robot that drives east is stopped by what lies at a place."""
    at = xy(east_m - RADIUS_M - REACH_M, south_m)
    return {"t": t, **at, "heading_deg": 90.0, "speed_m_s": 0.0, "commanded_m_s": 1.0, "event": event}


class TestOnceASpot:
    """Contacts in one square metre of ground: that from (20, 5) to (21, 6), on class 1."""

    def test_two_logs_share_the_weight_of_one(self, classes: Path) -> None:
        logs = [[hit(20.2, 5.2)], [hit(20.8, 5.8, "stuck")]]
        found = learn(classes, *logs)
        assert beta(found, 1) == pytest.approx((1, 1 + EVENT_M))
        assert found.after[1].evidence_m == pytest.approx(EVENT_M)
        assert found.logs is not None
        assert [each.evidence_m for each in found.logs] == pytest.approx([EVENT_M / 2] * 2)
        assert found.totals()["events"] == 2

    def test_no_metre_that_was_driven_is_shared(self, classes: Path) -> None:
        logs = [[*RUN[:-1], STOP], [{**each, "t": each["t"] + 100} for each in (*RUN[:-1], STOP)]]
        found = learn(classes, *logs)
        assert beta(found, 0) == pytest.approx((1 + 2 * 17, 1))
        assert beta(found, 1) == pytest.approx((1, 1 + EVENT_M))

    def test_events_of_two_kinds_weigh_their_mean(self, classes: Path) -> None:
        found = learn(classes, [hit(20.2, 5.2)], [hit(20.8, 5.8, "intervention")])
        assert beta(found, 1) == pytest.approx((1, 1 + 0.75 * EVENT_M))

    def test_so_do_those_of_one_log(self, classes: Path) -> None:
        away = {**hit(10.5, 5.5), "event": None}
        records = [{**each, "t": 100.0 * i} for i, each in enumerate([hit(20.2, 5.5), away] * 5)]
        found = learn(classes, [{k: v for k, v in each.items() if v is not None} for each in records])
        assert found.totals()["events"] == 5
        assert beta(found, 1) == pytest.approx((1, 1 + EVENT_M))

    @pytest.mark.parametrize("other", [(20.5, 4.5), (21.5, 5.5), (20.5, 5.5 + 3 * SPOT_M)])
    def test_spots_beside_one_another_count_each(self, classes: Path, other: tuple[float, float]) -> None:
        found = learn(classes, [hit(20.5, 5.5)], [hit(*other)])
        assert beta(found, 1) == pytest.approx((1, 1 + 2 * EVENT_M))

    def test_what_a_table_counts_already_counts_beside_it(self, classes: Path) -> None:
        logs = [
            put_log(classes.with_name(f"{name}.jsonl"), [hit(20.5, 5.5, t=t)]) for t, name in ((0.0, "a"), (1.0, "b"))
        ]
        assert beta(learn(classes, *logs), 1) == pytest.approx((1, 1 + EVENT_M))
        learn(classes, logs[0])
        table = classes.with_name("out.json").rename(classes.with_name("first.json"))
        assert beta(learn(classes, logs[1], scores_path=table), 1) == pytest.approx((1, 1 + 2 * EVENT_M))

    @settings(max_examples=20)
    @given(order=st.permutations(range(5)))
    def test_no_byte_depends_on_the_order_of_logs(self, crowded: tuple[Path, list[Path]], order: list[int]) -> None:
        classes, logs = crowded
        for name, at in (("a.json", range(5)), ("b.json", order)):
            learn_scores([logs[i] for i in at], classes, classes.with_name(name), FeedbackSettings(), existing=AGAIN)
        assert classes.with_name("a.json").read_bytes() == classes.with_name("b.json").read_bytes()

    @given(
        st.lists(
            st.lists(st.tuples(st.integers(0, 2), st.floats(0.01, 50), st.integers(-1, 2)), max_size=6),
            min_size=1, max_size=6,
        ),
        st.randoms(),
    )  # fmt: skip
    def test_no_bit_depends_on_the_order_of_drives(
        self, drives: list[list[tuple[int, float, int]]], shuffled: random.Random
    ) -> None:
        made = [evidence(each) for each in drives]
        before = dict.fromkeys(range(3), ClassScore(1, 1))
        found = []
        for _ in range(3):
            shared = settled(made)
            assert [each.weight_m.size for each in shared] == [each.weight_m.size for each in made]
            found.append(updated(before, shared, None))
            shuffled.shuffle(made)
        assert found[0] == found[1] == found[2]


def evidence(rows: list[tuple[int, float, int]]) -> Evidence:
    """Evidence of class, weight and spot (0, 1 or 2; -1: driven over), without progress; each row its own episode."""
    spots = [(0, spot) for _, _, spot in rows if spot >= 0]
    numbers = np.cumsum([spot >= 0 for _, _, spot in rows], dtype=np.int64) - 1
    episode = np.where([spot >= 0 for _, _, spot in rows], numbers, -1) if rows else np.zeros(0, np.int64)
    class_id, weight = np.array([k for k, _, _ in rows], np.int64), np.array([w for _, w, _ in rows], float)
    return Evidence(class_id, weight, np.zeros(len(rows)), episode, spots, 0.0, 0.0, len(spots), None, 0)


def test_spots_share_by_how_often_they_were_met() -> None:
    shared = settled([evidence([(1, 6.0, 0), (0, 4.0, -1), (1, 6.0, 2)]), evidence([(1, 9.0, 0), (1, 3.0, 0)])])
    assert shared[0].weight_m.tolist() == pytest.approx([2.0, 4.0, 6.0])
    assert shared[1].weight_m.tolist() == pytest.approx([3.0, 1.0])


def test_ground_that_is_driven_over_every_day_is_not_blamed_for_what_is_met_for_the_first_time() -> None:
    """Blame as share squared over metres made good and two more, in numbers worked out by hand."""

    def drive(way: list[tuple[int, float, float]], ahead: dict[int, float]) -> Evidence:
        rows = [(k, w, y, -1) for k, w, y in way] + [(k, w, 0.0, 0) for k, w in ahead.items()]
        class_id, weight, progress, episode = (np.array(column) for column in zip(*rows, strict=True))
        spots = [(0, 0)] if ahead else []
        return Evidence(class_id, weight.astype(float), progress, episode, spots, 0.0, 0.0, len(spots), None, 0)

    # 60 % of the ground ahead is class 0, of which 48 m were made good here and 50 m in another drive; 40 % is new.
    met = drive([(0, 60.0, 0.8)], {0: 3.0, 1: 2.0})
    other = drive([(0, 50.0, 1.0)], {})
    blamed = settled([met, other])[0].weight_m[1:]
    parts = np.array([0.6**2 / (98 + UNTRIED_M), 0.4**2 / UNTRIED_M])
    assert blamed == pytest.approx(5.0 * parts / parts.sum())
    assert blamed[1] / blamed[0] > 20
    # Of two that were never met the larger one takes more than its share, and alone a class takes all.
    alone = settled([drive([], {0: 4.0, 1: 1.0})])[0].weight_m
    assert alone == pytest.approx([5.0 * 16 / 17, 5.0 / 17])
    assert settled([drive([(0, 500.0, 1.0)], {0: 5.0})])[0].weight_m[1:] == pytest.approx([5.0])


@pytest.fixture(scope="module")
def crowded(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, list[Path]]:
    """Five drives against the same square metre, not quite in the same place."""
    folder = tmp_path_factory.mktemp("crowded")
    rng = np.random.default_rng(1)
    logs = []
    for index in range(5):
        at = (20.1 + 0.8 * float(rng.random()), 5.1 + 0.8 * float(rng.random()))
        end = hit(*at, ("collision", "intervention", "stuck")[index % 3], t=17.3 + index)
        logs.append(put_log(folder / f"{index}.jsonl", [*RUN[:-1], end]))
    return put_classes(folder / "classes.tif", halves(), names=3), logs


@pytest.fixture(scope="module")
def drives(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, list[Path]]:
    folder = tmp_path_factory.mktemp("drives")
    rng = np.random.default_rng(0)
    logs = []
    for index in range(4):
        speed = float(rng.uniform(0.4, 1.3))
        drive = eastward(20 + index, speed=speed, east_m=float(rng.uniform(1, 9)), step_s=0.7)
        for each in drive:
            each["speed_m_s"] = float(rng.uniform(0.1, 1.1))
            if index != 2:
                each["commanded_m_s"] = 1.1
        drive[-1]["event"] = "stuck"
        logs.append(put_log(folder / f"{index}.jsonl", drive))
    return put_classes(folder / "classes.tif", halves(), names=3), logs


@settings(max_examples=24)
@given(order=st.permutations(range(4)))
def test_the_order_of_logs_does_not_matter_in_any_byte(drives: tuple[Path, list[Path]], order: list[int]) -> None:
    classes, logs = drives
    for name, at in (("a.json", range(4)), ("b.json", order)):
        learn_scores([logs[i] for i in at], classes, classes.with_name(name), FeedbackSettings(), existing=AGAIN)
    assert classes.with_name("a.json").read_bytes() == classes.with_name("b.json").read_bytes()


def test_logs_one_after_another_come_to_the_same(drives: tuple[Path, list[Path]]) -> None:
    classes, logs = drives
    together = learn(classes, *logs)
    table = None
    for index, log in enumerate(logs):
        output = classes.with_name(f"chain{index}.json")
        step = learn_scores([log], classes, output, FeedbackSettings(), scores_path=table, existing=AGAIN)
        table = output
    assert table is not None
    for k in range(3):
        assert beta(step, k) == pytest.approx(beta(together, k), rel=1e-12)
    assert set(read_score_table(table).logs) == set(read_score_table(classes.with_name("out.json")).logs)
    assert len(read_score_table(table).logs) == 4


class TestPosterior:
    @given(st.lists(st.tuples(st.floats(1e-3, 1e4), st.floats(0, 1)), min_size=1, max_size=30), st.randoms())
    def test_no_bit_depends_on_the_order(self, steps: list[tuple[float, float]], shuffled: random.Random) -> None:
        found = []
        for _ in range(3):
            weights, progress = (np.array(each) for each in zip(*steps, strict=True))
            found.append(posterior(ClassScore(1.1, 0.3), weights, progress, None))
            shuffled.shuffle(steps)
        assert found[0] == found[1] == found[2]

    def test_forgetting_halves_what_is_old(self) -> None:
        before = ClassScore(101, 1, 100, "a")
        found = posterior(before, np.array([50.0]), np.array([0.0]), 50.0)
        assert (found.alpha, found.beta) == pytest.approx((1 + 100 / 2, 1 + 50))
        assert (found.evidence_m, found.name) == (pytest.approx(50 + 50), "a")

    @given(st.lists(st.tuples(st.floats(0.01, 20), st.floats(0, 1)), min_size=1, max_size=30), st.floats(1, 1000))
    def test_forgetting_goes_on_step_by_step(self, steps: list[tuple[float, float]], forget_m: float) -> None:
        a, b = 5.0, 0.5
        for w, y in steps:
            d = 0.5 ** (w / forget_m)
            a, b = 1 + (a - 1) * d + w * y, 1 + (b - 1) * d + w * (1 - y)
        weights, progress = (np.array(each) for each in zip(*steps, strict=True))
        found = posterior(ClassScore(5, 0.5), weights, progress, forget_m)
        assert (found.alpha, found.beta) == pytest.approx((a, b))

    def test_it_never_forgets_unasked(self) -> None:
        found = posterior(ClassScore(101, 1), np.full(9, 1e6), np.zeros(9), None)
        assert found.alpha == 101

    def test_with_forgetting_the_order_counts(self, classes: Path) -> None:
        good = eastward(15, speed_m_s=1.0, commanded_m_s=1.0)
        bad = eastward(15, speed=0.1, t0=100, speed_m_s=0.1, commanded_m_s=1.0)
        late, early = (learn(classes, *logs, forget_m=10.0) for logs in ((good, bad), (bad, good)))
        assert late.after[0].mean < 0.4 < 0.6 < early.after[0].mean
        assert learn(classes, good, bad).after == learn(classes, bad, good).after


class TestBefore:
    def test_only_what_was_driven_over_changes(self, classes: Path) -> None:
        prior = {0: ClassScore(3.3, 1.7, 0.1 + 0.2, "lawn"), 1: ClassScore(0.1, 0.7), 9: ClassScore(2.2, 5.5, 7.7, "x")}
        table = classes.with_name("prior.json")
        table.write_text(json.dumps(scores_document(prior)))
        found = learn(classes, eastward(10, speed_m_s=1.0, commanded_m_s=1.0), scores_path=table)
        after = read_score_table(classes.with_name("out.json")).scores
        assert after == found.after
        assert after[0] == ClassScore(13.3, 1.7, 10.3, "lawn")
        assert after[1] == ClassScore(0.1, 0.7, 0.0, "class 1")
        assert after[2] == ClassScore(1, 1, 0.0, "class 2")
        assert after[9] == prior[9]
        assert found.before[0] == prior[0]

    def test_a_foreign_raster_is_asked_for_its_classes(self, tmp_path: Path) -> None:
        values = halves().astype(np.uint8)
        values[0, 0], values[1, 1] = 77, 255
        place = Affine(PIXEL, 0, ORIGIN[0], 0, -PIXEL, ORIGIN[1])
        classes = write_raster(tmp_path / "c.tif", values, crs=UTM33, transform=place)
        found = learn(classes, eastward(10, speed_m_s=1.0, commanded_m_s=1.0))
        assert list(found.after) == [0, 1, 77]

    def test_the_same_drive_does_not_count_twice(self, classes: Path) -> None:
        log = put_log(classes.with_name("a.jsonl"), eastward(10, commanded_m_s=1.0))
        copy = classes.with_name("b.jsonl")
        copy.write_bytes(log.read_bytes())
        with pytest.raises(InputError, match=r"b\.jsonl: holds the same drive as .*a\.jsonl"):
            learn(classes, log, copy)
        first = learn(classes, log)
        table = classes.with_name("out.json").rename(classes.with_name("first.json"))
        with pytest.raises(InputError, match=r"b\.jsonl: is counted in .*first\.json already"):
            learn(classes, copy, scores_path=table)
        other = put_log(classes.with_name("c.jsonl"), eastward(5, commanded_m_s=1.0))
        assert learn(classes, other, scores_path=table).before == first.after
        with pytest.raises(InputError, match="already"):
            learn(classes, copy, scores_path=classes.with_name("out.json"))


class TestCurve:
    def test_it_bends_progress(self, classes: Path) -> None:
        drive = eastward(10, speed_m_s=0.6, commanded_m_s=1.0)
        assert beta(learn(classes, drive, curve=Curve.parse("0:0,.5:0.2,.7:1")), 0) == pytest.approx((7, 5))

    def test_a_speed_above_the_command_is_all_there_is(self, classes: Path) -> None:
        assert beta(learn(classes, eastward(10, speed_m_s=2.0, commanded_m_s=1.0)), 0) == pytest.approx((11, 1))

    @pytest.mark.parametrize(
        "text",
        ["", "1", "0:0", "0:0,1:2", "0:-1,1:1", "0:1,1:0", "1:0,1:1", "1:0,0:1", "-1:0,1:1", "0:0,nan:1", "0:0,"],
    )
    def test_what_is_no_curve_is_refused(self, text: str) -> None:
        with pytest.raises(ArgumentError):
            Curve.parse(text)


class TestTerrain:
    @staticmethod
    def dsm(path: Path, heights: np.ndarray, pixel: float = PIXEL) -> Path:
        place = Affine(pixel, 0, ORIGIN[0], 0, -pixel, ORIGIN[1])
        return write_raster(path, heights.astype(np.float32), crs=UTM33, transform=place, nodata=-9999)

    DRIVE = eastward(10, speed_m_s=1.0, commanded_m_s=1.0)

    @pytest.mark.parametrize("pixel", [0.5, 1.0, 3.0])
    def test_a_slope_discounts_by_its_square(self, classes: Path, pixel: float) -> None:
        rise = np.tan(np.radians(20)) * 0.1 * pixel
        rows, cols = int(100 / pixel), int(400 / pixel)
        heights = 100 + rise * (np.arange(cols) * np.ones((rows, 1)))
        found = learn(classes, self.DRIVE, dsm_path=self.dsm(classes.with_name("d.tif"), heights, PIXEL * pixel))
        y = 1 - (20 / 35) ** 2
        assert beta(found, 0) == pytest.approx((1 + 10 * y, 1 + 10 * (1 - y)), rel=0.01)
        steep = learn(classes, self.DRIVE, dsm_path=classes.with_name("d.tif"), slope_limit_deg=19.0)
        assert beta(steep, 0) == pytest.approx((1, 11), abs=0.01)

    def test_rough_ground_discounts_and_level_ground_does_not(self, classes: Path) -> None:
        level = learn(classes, self.DRIVE, dsm_path=self.dsm(classes.with_name("l.tif"), np.full((100, 400), 50.0)))
        assert beta(level, 0) == pytest.approx((11, 1))
        checks = 50 + 0.15 * (-1.0) ** np.add.outer(np.arange(100), np.arange(400))
        rough = learn(classes, self.DRIVE, dsm_path=self.dsm(classes.with_name("r.tif"), checks))
        assert 0.5 < rough.after[0].mean < 0.85
        assert beta(learn(classes, self.DRIVE, dsm_path=classes.with_name("r.tif"), rugosity_limit_m=0.05), 0)[0] < 1.1

    def test_ground_without_heights_is_told_of(self, classes: Path) -> None:
        heights = np.full((100, 400), 50.0)
        heights[:, 70:] = -9999
        found = learn(classes, self.DRIVE, dsm_path=self.dsm(classes.with_name("d.tif"), heights))
        assert beta(found, 0) == pytest.approx((11, 1))
        assert "has no heights for 5" in found.notes[0]
        aside = self.dsm(classes.with_name("d.tif"), np.full((100, 10), 50.0))
        with pytest.raises(InputError, match=r"d\.tif: tells the height of no place"):
            learn(classes, self.DRIVE, dsm_path=aside)


def test_noise_of_the_receiver_neither_drives_nor_stalls(tmp_path: Path) -> None:
    classes = put_classes(tmp_path / "c.tif", np.zeros((100, 2000), np.uint8))
    rng = np.random.default_rng(0)

    def noisy(step_s: float, sigma_m: float, **more: float) -> list[dict[str, Any]]:
        shake = rng.normal(0, sigma_m, (2000, 2))
        drive = eastward(150, step_s=step_s, **more)
        drive += [{"t": 150 + step_s * i, **xy(152, 5), **more} for i in range(1, int(60 / step_s))]
        return [each | {"x": each["x"] + dx, "y": each["y"] + dy} for each, (dx, dy) in zip(drive, shake, strict=False)]

    for step_s, sigma_m in ((1.0, 0.15), (0.2, 0.3), (5.0, 0.3)):
        told = learn(classes, noisy(step_s, sigma_m), commanded_m_s=1.0)
        assert told.after[0].evidence_m == pytest.approx(150, abs=12)
        assert told.after[0].mean > 0.9, (step_s, sigma_m)
        guessed = learn(classes, noisy(step_s, sigma_m))
        assert guessed.after[0].mean > 0.85, (step_s, sigma_m)
        # Told to drive on, a robot that stands for a minute loses the minute.
        stalled = learn(classes, noisy(step_s, sigma_m, commanded_m_s=1.0))
        assert stalled.after[0].beta == pytest.approx(60, abs=15), (step_s, sigma_m)


def test_a_long_stand_in_the_noise_is_no_drive(tmp_path: Path) -> None:
    classes = put_classes(tmp_path / "c.tif", np.zeros((100, 2000), np.uint8))
    shake = np.random.default_rng(0).normal(0, 0.3, (1200, 2))
    drive = eastward(150) + [{"t": 150.0 + i, **xy(152, 5)} for i in range(1, 900)]
    noisy = [each | {"x": each["x"] + dx, "y": each["y"] + dy} for each, (dx, dy) in zip(drive, shake, strict=False)]
    found = learn(classes, noisy, commanded_m_s=1.0)
    assert found.after[0].evidence_m == pytest.approx(150, abs=15)
    assert found.after[0].mean > 0.85


def test_what_is_new_ahead() -> None:
    assert new_ahead({0: 0.5, 1: 0.5}, {0: 0.25}) == pytest.approx({0: 1 / 3, 1: 2 / 3})
    assert new_ahead({0: 0.5, 1: 0.5}, {0: 1.0}) == {1: 1.0}
    assert new_ahead({0: 1.0}, {0: 1.0}) == {0: 1.0}
    assert new_ahead({}, {0: 1.0}) == {}
    assert new_ahead({3: 1.0}, {}) == {3: 1.0}


def test_a_raster_in_degrees_tells_the_same(tmp_path: Path) -> None:
    values = np.kron(np.random.default_rng(1).integers(0, 3, (5, 20)), np.ones((20, 20))).astype(np.uint8)
    utm = put_classes(tmp_path / "utm.tif", values)
    place = Affine(PIXEL, 0, ORIGIN[0], 0, -PIXEL, ORIGIN[1])
    west, north = ORIGIN[0], ORIGIN[1]
    bounds = west, north - 100 * PIXEL, west + 400 * PIXEL, north
    there, cols, rows = calculate_default_transform(UTM33, "EPSG:4326", 400, 100, *bounds, resolution=(4e-7, 3e-7))
    turned = np.full((rows, cols), 255, np.uint8)
    reproject(
        values, turned, src_transform=place, src_crs=UTM33, dst_transform=there, dst_crs="EPSG:4326", src_nodata=255
    )
    (tmp_path / "degrees").mkdir()
    degrees = put_classes(tmp_path / "degrees" / "classes.tif", turned, crs="EPSG:4326", place=there)
    drive = eastward(30, speed=1.1, step_s=0.5, commanded_m_s=1.3)
    drive[-1] |= {"event": "collision", "heading_deg": 45.0}
    found = [learn(utm, drive), learn(degrees, drive), learn(degrees, in_degrees(drive), header={"crs": None})]
    for other in found[1:]:
        assert other.totals()["evidence_m"] == pytest.approx(found[0].totals()["evidence_m"], rel=1e-4)
        for k in range(3):
            assert beta(other, k) == pytest.approx(beta(found[0], k), abs=0.15)


@pytest.mark.parametrize("angle", [30.0, 200.0])
def test_headings_are_from_true_north_on_a_turned_raster(tmp_path: Path, angle: float) -> None:
    # Class 1 lies north of the robot, whichever way the raster is turned.
    middle = Affine.translation(*ORIGIN) @ Affine.rotation(angle) @ Affine.scale(PIXEL, -PIXEL)
    place = middle @ Affine.translation(-100, -100)
    col, row = np.meshgrid(np.arange(200) + 0.5, np.arange(200) + 0.5)
    north = place.d * col + place.e * row + place.f
    classes = put_classes(
        tmp_path / "c.tif", (north > ORIGIN[1] + CONTACT_RADIUS_M + 0.1).astype(np.uint8), place=place
    )
    here = {**xy(0, 0), "commanded_m_s": 1.0, "speed_m_s": 0.0}
    for heading, blamed in ((0.0, 1), (180.0, 0), (90.0, 0)):
        found = learn(classes, [{"t": 0.0, **here, "heading_deg": heading, "event": "stuck"}])
        assert found.after[blamed].beta == pytest.approx(1 + EVENT_M), heading


class TestRefused:
    DRIVE = eastward(5, commanded_m_s=1.0)

    @pytest.mark.parametrize(
        ("records", "problem"),
        [
            ([{**each, "y": each["y"] + 5000} for each in DRIVE], "lies wholly off the class raster"),
            ([*DRIVE, {"t": 1.0, **xy(1, 1)}], "time goes backwards"),
            ([*DRIVE, {"t": 1.0}], "needs either x and y"),
            ([{"t": 0, "lon": 15.0, "lat": 44.0}], "lies wholly off the class raster"),
            ([*DRIVE, {"t": 9.0, "x": 1e300, "y": 0.0}], "cannot be laid on the class raster|no place"),
            ([], "no records"),
        ],
    )
    def test_logs(self, classes: Path, records: list[dict[str, Any]], problem: str) -> None:
        with pytest.raises(InputError, match=rf"log0\.jsonl: .*({problem})"):
            learn(classes, records)
        assert not classes.with_name("out.json").exists()

    def test_a_crs_that_is_none(self, classes: Path) -> None:
        with pytest.raises(InputError, match="cannot be laid on the class raster"):
            learn(classes, self.DRIVE, header={"crs": "moon"})

    def test_without_a_crs_places_are_those_of_the_raster(self, classes: Path) -> None:
        found = learn(classes, self.DRIVE, header={"crs": None})
        assert found.totals()["evidence_m"] == pytest.approx(5)
        assert "names no CRS" in found.notes[0]

    def test_not_a_number_and_cut_short(self, classes: Path) -> None:
        log = classes.with_name("a.csv")
        log.write_text("t,x,y\n0,nan,5\n")
        with pytest.raises(InputError, match="not a finite number"):
            learn(classes, log)
        log.write_text("t,x,y\n0,1,5\n1,2,5.")
        with pytest.raises(InputError, match="cut off"):
            learn(classes, log)

    def test_a_model_of_three_bands(self, classes: Path) -> None:
        with pytest.raises(InputError, match="has 3 bands"):
            learn(classes, self.DRIVE, dsm_path=write_raster(classes.with_name("d.tif"), np.ones((3, 9, 9), np.uint8)))

    def test_a_robot_as_large_as_the_site(self, classes: Path) -> None:
        with pytest.raises(HrtError, match="radius"):
            learn(classes, self.DRIVE, robot_radius_m=1e6)


def test_a_robot_smaller_than_a_pixel_stands_on_one(tmp_path: Path) -> None:
    classes = put_classes(tmp_path / "c.tif", halves(20, 20, 10), place=Affine(2, 0, ORIGIN[0], 0, -2, ORIGIN[1]))
    found = learn(classes, eastward(10, speed_m_s=1.0, commanded_m_s=1.0), robot_radius_m=0.01)
    assert found.after[0].evidence_m == pytest.approx(10)


def test_only_the_ground_about_the_track_is_read(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    from hrt_cli.raster.classes import ClassRaster

    classes = put_classes(tmp_path / "c.tif", np.zeros((3000, 3000), np.uint8))
    pixels: list[int] = []
    whole = ClassRaster.read

    def read(self: ClassRaster, window: Any) -> Any:
        pixels.append(window.height * window.width)
        return whole(self, window)

    monkeypatch.setattr(ClassRaster, "read", read)
    learn(classes, eastward(100, speed_m_s=1.0, commanded_m_s=1.0))
    assert 0 < sum(pixels) < 3000 * 3000 / 10


@pytest.mark.real
@pytest.mark.skipif(not HUSKY.exists(), reason="the Husky's log is not here")
def test_a_real_drive(tmp_path: Path) -> None:
    with open(HUSKY, encoding="utf-8") as file:
        names = file.readline().strip().split(",")
        table = np.loadtxt(file, delimiter=",")
    lon, lat = table[:, names.index("lon")], table[:, names.index("lat")]
    x, y = map(np.array, transform("EPSG:4326", "EPSG:32619", lon, lat))
    place = Affine(0.1, 0, np.floor(x.min()) - 5, 0, -0.1, np.ceil(y.max()) + 5)
    rows, cols = int((place.f - y.min() + 5) / 0.1), int((x.max() + 5 - place.c) / 0.1)
    values = np.where(np.arange(cols) < (np.median(x) - place.c) / 0.1, 0, 1) * np.ones((rows, 1), int)
    values[:20] = 2
    classes = put_classes(tmp_path / "c.tif", values, crs="EPSG:32619", place=place)
    found = learn(classes, HUSKY)
    # The wheels say 359 m at 1 m/s; the legs of the raw log add up to 395 m.
    assert found.totals()["evidence_m"] == pytest.approx(359, rel=0.03)
    assert "taken as 1.0" in found.notes[0]
    for k in (0, 1):
        assert 0.8 < found.after[k].mean < 0.97
        assert found.after[k].evidence_m > 100
    assert found.after[2] == ClassScore(1, 1, 0.0, "class 2")
