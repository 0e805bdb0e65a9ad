"""Where the numbers come from: recordings, settings, versions, and the rounds of the solve."""

import json

import numpy as np
import yaml

from calib.geometry.units import MM_PER_M, NS_PER_S
from calib.io.config import default_config_blocks
from calib.report.number_format import DASH, format_count, format_number


def tabulate_convergence(run):
    """Rows of the rounds of solving and re-association."""
    it = run.iterations
    return [
        {
            "round": int(it["round"][i]),
            "cost": format_number(float(it["cost"][i]), 6),
            "ipopt": int(it["ipopt_iterations"][i]),
            "n_inliers": format_count(int(it["n_inliers"][i])),
            "n_reassigned": format_count(int(it["n_reassigned"][i])),
            "step_m": format_number(float(it["step_m"][i]) * MM_PER_M, 2),
            "step_rad": format_number(float(np.degrees(it["step_rad"][i])), 2),
        }
        for i in range(len(it["round"]))
    ]


def summarize_provenance(run):
    """Versions, log fingerprints and the config that the stages were given."""
    known = run.calibration["provenance"]
    logs = {
        n: [line.split() for line in s.audit.get("fingerprint", [])]
        for n, s in run.sessions.items()
    }
    config = {k: run.options[k] for k in ("sensors", "targets")}
    spans = {n: format_duration(s.frames["stamp_ns"]) for n, s in run.sessions.items()}
    return {
        "packages": sorted(known.get("packages", {}).items()),
        "other": {k: v for k, v in sorted(known.items()) if k not in ("packages", "sessions")},
        "schema_version": run.calibration["schema_version"],
        "logs": logs,
        "spans": spans,
        "settings": list_changed_settings(run.options["settings"]),
        "config": yaml.safe_dump(config, default_flow_style=None, allow_unicode=True, width=110),
    }


def format_duration(t):
    """`30.1 s` from the first to the last of the stamps t (n,), ns; a dash of none."""
    return f"{format_number((t.max() - t.min()) / NS_PER_S)} s" if len(t) else DASH


def list_changed_settings(blocks):
    """[(key, value, default)] of what config.yaml states otherwise than the defaults."""
    usual, out = default_config_blocks(), []
    for stage, block in sorted(blocks.items()):
        out += _list_changed_leaves(stage, block, usual[stage])
    return [(k, *(json.dumps(v, ensure_ascii=False) for v in pair)) for k, *pair in out]


def _list_changed_leaves(key, value, usual):
    """[(key, value, default)] of the leaves of two nested dicts that differ."""
    if not isinstance(value, dict) or not isinstance(usual, dict):
        return [] if value == usual else [(key, value, usual)]
    return [
        row
        for k in sorted(value)
        for row in _list_changed_leaves(f"{key}.{k}", value[k], usual.get(k))
    ]
