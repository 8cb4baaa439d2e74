"""The report of `extremal strip`."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from rich.table import Table

from extremal.scripts.report import Report
from extremal.scripts.report_scene import Scene3D

PICTURES = {
    "strip.png": "The conjugate grid over the first view, and its vertices' distances to the truth beside their sigma.",
    "prediction.png": "The strip in views that it was not made of, and the edges there against the prediction.",
    "extrapolation.png": "The surface continued beyond the strip, as far as its own sigma lets it be trusted.",
}


def strip_report(
    folder: Path,
    view: Scene3D,
    caption: str,
    table: Table,
    content: Mapping[str, Any],
    settings: Mapping[str, Any],
) -> Report:
    """The surface in 3D, the pictures of the `folder`, and the command's table; `content` is that of result.json."""
    facts = {
        name: f"{1e3 * content[key]:.3f} mm"
        for name, key in (("rms to truth", "rms_m"), ("95 %", "p95_m"))
        if content.get(key)
    }
    if content["prediction_rms_px"] is not None:
        facts["unseen views, rms"] = f"{content['prediction_rms_px']:.3f} px"
    report = Report(
        f"extremal strip: {settings['scene']}", f"{settings['views']} views, seed {settings['seed']}"
    )
    report.facts(facts).scene(view, caption)
    for name, words in PICTURES.items():
        stored = cv2.imread(str(folder / name))
        if stored is not None:
            report.picture(cv2.cvtColor(stored, cv2.COLOR_BGR2RGB).astype(np.uint8), words)
    return (
        report.table(table).section("How it was made").settings({**settings, "timing_s": content["timing_s"]})
    )
