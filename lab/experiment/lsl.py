"""The lab streaming layer: what happens in a session, as a stream of markers.

LSL stamps each marker when it is pushed, and gives it to whoever records (LabRecorder). The stream
is named ``coulombus``, of type ``Markers``, one channel of text, irregular; its description has the
study and the subject.
"""

from __future__ import annotations

import importlib
from typing import Any

from coulombus.lab.experiment.folder import SubjectFolder

__all__ = ["LslMarkers", "LslMissing"]


class LslMissing(Exception):
    """The library of LSL is not installed, or cannot be used; the text says what to do."""

    exit_status = 2


class LslMarkers:
    """An outlet for the markers of a subject's session; each call sends one."""

    def __init__(self, folder: SubjectFolder) -> None:
        try:
            lsl: Any = importlib.import_module("pylsl")
        except (ImportError, RuntimeError, OSError) as error:
            raise LslMissing(f"LSL needs pylsl and its liblsl ({error}): pip install 'coulombus[lsl]'") from None
        source = f"coulombus-{folder.study.file.name}-{folder.subject}"
        info = lsl.StreamInfo("coulombus", "Markers", 1, lsl.IRREGULAR_RATE, lsl.cf_string, source)
        described = info.desc()
        described.append_child_value("study", folder.study.file.name)
        described.append_child_value("subject", folder.subject)
        self._outlet = lsl.StreamOutlet(info)

    def __call__(self, text: str) -> None:
        """Send a marker, stamped now."""
        self._outlet.push_sample([text])
