"""Where the numbers come from: recordings, settings, versions, and the rounds of the solve."""

import json

import numpy as np
import yaml

from calib.io.config import defaults
from calib.report import number_format
from calib.report.sections.extrinsics import MM

NS = 1e9


def convergence(run):
    """Rows of the rounds of solving and re-association."""
    it = run.iterations
    return [
        {
            "round": int(it["round"][i]),
            "cost": number_format.number(float(it["cost"][i]), 6),
            "ipopt": int(it["ipopt_iterations"][i]),
            "members": number_format.count(int(it["members"][i])),
            "changed": number_format.count(int(it["changed"][i])),
            "step_m": number_format.number(float(it["step_m"][i]) * MM, 2),
            "step_rad": number_format.number(float(np.degrees(it["step_rad"][i])), 2),
        }
        for i in range(len(it["round"]))
    ]


def provenance(run):
    """Versions, log fingerprints and the config that the stages were given."""
    known = run.calibration["provenance"]
    logs = {
        n: [line.split() for line in s.audit.get("fingerprint", [])]
        for n, s in run.sessions.items()
    }
    config = {k: run.options[k] for k in ("sensors", "targets")}
    spans = {n: duration(s.frames["t"]) for n, s in run.sessions.items()}
    return {
        "packages": sorted(known.get("packages", {}).items()),
        "other": {k: v for k, v in sorted(known.items()) if k not in ("packages", "sessions")},
        "schema_version": run.calibration["schema_version"],
        "logs": logs,
        "spans": spans,
        "settings": settings(run.options["settings"]),
        "config": yaml.safe_dump(config, default_flow_style=None, allow_unicode=True, width=110),
    }


def duration(t):
    """`30.1 s` from the first to the last of the stamps t (n,), ns; a dash of none."""
    return f"{number_format.number((t.max() - t.min()) / NS)} s" if len(t) else number_format.DASH


def settings(blocks):
    """[(key, value, default)] of what config.yaml states otherwise than the defaults."""
    usual, out = defaults(), []
    for stage, block in sorted(blocks.items()):
        out += _changed(stage, block, usual[stage])
    return [(k, *(json.dumps(v, ensure_ascii=False) for v in pair)) for k, *pair in out]


def _changed(key, value, usual):
    """[(key, value, default)] of the leaves of two nested dicts that differ."""
    if not isinstance(value, dict) or not isinstance(usual, dict):
        return [] if value == usual else [(key, value, usual)]
    return [row for k in sorted(value) for row in _changed(f"{key}.{k}", value[k], usual.get(k))]
