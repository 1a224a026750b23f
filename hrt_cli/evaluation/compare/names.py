"""The figures of each kind of artifact that take a tolerance; those of JSON are its paths."""

from __future__ import annotations

from hrt_cli.evaluation.compare.kinds import Kind

_GRID = ("shift_m", "pixel_m")
_PLAN = (
    *("score", "discounted_score", "upper_bound", "gap", "discounted_upper_bound", "discounted_gap"),
    *("length_m", "time_s", "steps", "apart_m", "overlap", "order", "start_m", "end_m", "coordinates_m"),
    *("waypoints", "robots", "settings"),
    *_GRID,
)
_MODEL = ("max", "relative", "tensors", "settings")

NAMES: dict[Kind, tuple[str, ...]] = {
    "classes": ("changed", "iou", "ari", "names", *_GRID),
    "scoremap": ("rmse", "max", "no_go", "go", "sd_rmse", "sd_max", "sd_unknown", *_GRID),
    "scores": ("rmse", "max", "sd_max", "evidence_m", "classes", "names"),
    "plan": _PLAN,
    "team plan": _PLAN,
    "texture model": _MODEL,
    "policy": _MODEL,
    "steering model": _MODEL,
    "drive log": (
        *("apart_m", "distance_m", "duration_s", "collisions", "interventions", "stuck", "stalled_s", "records"),
        *(
            "events",
            "breaks",
            "times_s",
            "speed_m_s",
            "commanded_m_s",
            "heading_deg",
            "pitch_deg",
            "roll_deg",
            "depth_m",
        ),
    ),
}
