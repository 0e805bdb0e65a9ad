"""Origin of the numbers: recordings, settings, versions, and the rounds of the solve."""

import json
from typing import Any

import numpy as np
import yaml

from calib.geometry.units import DEG_PER_RAD, MM_PER_M, NS_PER_S
from calib.io.config import default_config_blocks
from calib.report.data.run_data import ReportRun
from calib.report.number_format import DASH, format_count, format_number


def tabulate_convergence(run: ReportRun) -> list[dict[str, Any]]:
    """Return one row per round of the solve."""
    rounds = run.iterations
    return [
        {
            "round": int(rounds["round"][i]),
            "cost": format_number(float(rounds["cost"][i]), 6),
            "ipopt_iterations": int(rounds["ipopt_iterations"][i]),
            "n_inliers": format_count(int(rounds["n_inliers"][i])),
            "n_reassigned": format_count(int(rounds["n_reassigned"][i])),
            "step_mm": format_number(float(rounds["step_m"][i]) * MM_PER_M, 2),
            "step_deg": format_number(float(rounds["step_rad"][i]) * DEG_PER_RAD, 2),
        }
        for i in range(len(rounds["round"]))
    ]


def summarize_provenance(run: ReportRun) -> dict[str, Any]:
    """Return versions, fingerprints of the logs, and the config of the stages."""
    provenance = run.calibration["provenance"]
    config = {k: run.options[k] for k in ("sensors", "targets")}
    return {
        "packages": sorted(provenance.get("packages", {}).items()),
        "other_versions": {
            k: v for k, v in sorted(provenance.items()) if k not in ("packages", "sessions")
        },
        "schema_version": run.calibration["schema_version"],
        "logs": {
            name: [line.split() for line in session.audit.get("fingerprint", [])]
            for name, session in run.sessions.items()
        },
        "durations": {
            name: format_duration(session.frames["stamp_ns"])
            for name, session in run.sessions.items()
        },
        "settings": list_changed_settings(run.options["settings"]),
        "config": yaml.safe_dump(config, default_flow_style=None, allow_unicode=True, width=110),
    }


def format_duration(stamps_ns: np.ndarray) -> str:
    """Format the time from the first to the last stamp (n,), ns: `30.1 s`; a dash without any."""
    if not len(stamps_ns):
        return DASH
    return f"{format_number((stamps_ns.max() - stamps_ns.min()) / NS_PER_S)} s"


def list_changed_settings(blocks: dict[str, Any]) -> list[tuple[str, str, str]]:
    """Return (key, value, default) of the settings of config.yaml that are not the defaults."""
    defaults = default_config_blocks()
    return [
        (key, json.dumps(value, ensure_ascii=False), json.dumps(default, ensure_ascii=False))
        for stage, block in sorted(blocks.items())
        for key, value, default in _list_changed_leaves(stage, block, defaults[stage])
    ]


def _list_changed_leaves(key: str, value: Any, default: Any) -> list[tuple[str, Any, Any]]:
    """Return (key, value, default) of the leaves of two nested dicts that differ."""
    if not isinstance(value, dict) or not isinstance(default, dict):
        return [] if value == default else [(key, value, default)]
    return [
        row
        for k in sorted(value)
        for row in _list_changed_leaves(f"{key}.{k}", value[k], default.get(k))
    ]
