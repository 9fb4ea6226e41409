"""The lab streaming layer: what happens in a session, and what was measured, as streams.

LSL gives samples to whoever records (LabRecorder), with their stamps by LSL's own clock.

- ``coulombus``, type ``Markers``: one channel of text, irregular, stamped as it happens.
- ``coulombus-signals``, type ``Haptics``: a channel for each signal of the rig's PDOs, a sample each
  period of the bus. A display's samples come together when it has ended, because nothing may disturb
  its cycle; each has the stamp of when it was measured.

The description of both has the study and the subject.
"""

from __future__ import annotations

import importlib
import time
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from coulombus.lab.study.study_folder import SubjectFolder
from coulombus.recording.reading import read
from coulombus.recording.signals import Recording
from coulombus.system.errors import CoulombusError

__all__ = ["LslMarkers", "LslMissing", "LslSignals"]


class LslMissing(CoulombusError):
    """The library of LSL is not installed, or cannot be used; the text says what to do."""

    exit_status = 2


def _library() -> Any:
    try:
        return importlib.import_module("pylsl")
    except (ImportError, RuntimeError, OSError) as error:
        raise LslMissing(f"LSL needs pylsl and its liblsl ({error}): pip install -e '.[lsl]' in the clone") from None


def _described(info: Any, folder: SubjectFolder) -> Any:
    described = info.desc()
    described.append_child_value("study", folder.study.file.name)
    described.append_child_value("subject", folder.subject)
    return described


class LslMarkers:
    """An outlet for the markers of a subject's session; each call sends one."""

    def __init__(self, folder: SubjectFolder) -> None:
        lsl = _library()
        source = f"coulombus-{folder.study.file.name}-{folder.subject}"
        info = lsl.StreamInfo("coulombus", "Markers", 1, lsl.IRREGULAR_RATE, lsl.cf_string, source)
        _described(info, folder)
        self._outlet = lsl.StreamOutlet(info)

    def __call__(self, text: str) -> None:
        """Send a marker, stamped now."""
        self._outlet.push_sample([text])


class LslSignals:
    """An outlet for the signals of a subject's displays; each call sends a display's."""

    def __init__(self, folder: SubjectFolder) -> None:
        self._lsl = lsl = _library()
        rig = folder.study.rig
        self._period_s = rig.bus.period_s
        self._units = {signal.name: signal.unit for pdo in rig.pdos() for signal in pdo.signals}
        source = f"coulombus-signals-{folder.study.file.name}-{folder.subject}"
        rate, count = 1.0 / self._period_s, len(self._units)
        info = lsl.StreamInfo("coulombus-signals", "Haptics", count, rate, lsl.cf_double64, source)
        channels = _described(info, folder).append_child("channels")
        for name, unit in self._units.items():
            channel = channels.append_child("channel")
            channel.append_child_value("label", name)
            channel.append_child_value("unit", unit)
        self._outlet = lsl.StreamOutlet(info)

    def __call__(self, path: Path) -> None:
        """Send the signals of the display that was recorded at `path`.

        Raises
        ------
        coulombus.recording.pcapng_blocks.RecordingError
            it is no recording
        """
        recording = read(path)
        t_s, samples = sampled(recording, list(self._units), self._period_s)
        if not len(t_s):
            return
        now_s = self._lsl.local_clock()
        if recording.epoch_ns:  # a bus: stamps of the wall clock
            stamps = t_s + recording.epoch_ns * 1e-9 + (now_s - time.time())
        else:  # virtual time: as if it had ended now
            stamps = t_s - t_s[-1] + now_s
        for sample, stamp in zip(samples.tolist(), stamps.tolist(), strict=True):
            self._outlet.push_sample(sample, stamp)


def sampled(
    recording: Recording, names: list[str], period_s: float
) -> tuple[npt.NDArray[np.float64], npt.NDArray[np.float64]]:
    """Return times [s], shape (n,), and what signals were last by then, shape (n, len(names)); NaN
    where one had not come yet.
    """
    ends = [recording[name].t_s for name in names if len(recording[name].t_s)]
    if not ends:
        return np.zeros(0), np.zeros((0, len(names)))
    begin, end = min(float(stamps[0]) for stamps in ends), max(float(stamps[-1]) for stamps in ends)
    t_s: npt.NDArray[np.float64] = begin + period_s * np.arange(int((end - begin) / period_s) + 1, dtype=np.float64)
    return t_s, np.column_stack([recording[name].held(t_s, np.nan) for name in names])
