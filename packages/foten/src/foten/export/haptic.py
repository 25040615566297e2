"""The .haptic format, version 1.0, of Lofelt and Meta, by its published specification: envelopes in JSON."""

from pathlib import Path

from foten.atomic_write import write_json
from foten.export.clip import Clip, envelopes_of

KEEPS = ".haptic keeps the envelope, not the waveform"


def write_haptic(clip: Clip, path: Path) -> None:
    """Write a clip."""
    envelopes = envelopes_of(clip)
    written = {
        name: [{"time": round(float(t), 6), name: round(float(value), 4)} for t, value in getattr(envelopes, name)]
        for name in ("amplitude", "frequency")
    }
    document = {
        "version": {"major": 1, "minor": 0, "patch": 0},
        "metadata": {
            "editor": f"foten {clip.about.get('foten', '')}".strip(),
            "author": str(clip.about.get("credit", "")),
            "source": str(clip.about.get("texture", "")),
            "project": "",
            "tags": ["texture"],
            "description": "; ".join(str(clip.about[key]) for key in ("stroke", "made") if key in clip.about),
        },
        "signals": {"continuous": {"envelopes": written}},
    }
    write_json(path, document)
