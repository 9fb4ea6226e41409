"""The base of all errors of this project.

Each class has a text for people and an exit status for the command line. A class that also derives from a Python
exception is caught by an ``except`` of that exception, too. `n`: each error has the status of the run that has ended.

CoulombusError
+-- AddressError                 2   wire.address                 ValueError
+-- BusUnavailable               4   wire.address                 OSError
|   +-- BusDown                  4   wire.client
|   +-- BusGone                  4   wire.client
+-- ChannelError                 2   recording.bus_match
+-- ClusterError                 2   lab.sweep.cluster
+-- CommissionError              1   host.commission.step
+-- ConditionError               3   lab.sweep.expressions        ValueError
+-- ConformanceRefused           7   conformance.runner
+-- DeviceSilent                 5   conformance.runner
+-- EdsError                     3   eds.description
+-- Ended                        n   lab.study.session
+-- ExportError                  2   recording.export.errors
+-- FaultError                   3   sim_bus.faults.fault_file    ValueError
+-- FaultRefused                 2   sim_bus.faults.live_faults
|   +-- NodeUnknown              5   sim_bus.faults.live_faults
+-- FeltError                    2   lab.study.felt_torque
+-- HardwareError                3   node.hardware.channels
|   +-- NoBuffer                 3   node.hardware.iio_buffer
+-- HostError                    1   host.errors
|   +-- AnswerUntrusted          6   host.errors
|   |   +-- SdoProtocolError     6   host.sdo.transfers
|   |       +-- DuplicateNodeId  3   host.sdo.transfers
|   +-- ChangeRefused            2   host.cycle.parameter_changes
|   |   +-- NotTaken             2   host.cycle.parameter_changes
|   +-- DeviceMismatch           3   host.errors
|   +-- LssRefused               6   host.devices.lss
|   +-- MalformedMessage         2   host.world.relay
|   +-- ModelRefused             2   host.world.model_check
|   +-- NoHost                   4   host.run.control_socket
|   +-- NoWorld                  4   host.world.hand
|   +-- NodeMissing              5   host.errors
|   |   +-- SdoSilent            5   host.sdo.transfers
|   +-- NotChanged               2   host.run.control_socket
|   +-- NotMarked                2   host.run.control_socket
|   +-- ObjectUnknown            2   host.devices.device
|   +-- PlaneError               4   host.realtime.data_plane
|   +-- SafetyTrip               7   host.errors
|   +-- SdoAborted               6   host.errors
|   |   +-- SdoRefused           6   host.sdo.transfers
|   +-- SimDied                  4   lab.demo.real_demo
|   +-- StatusError              2   host.run.status_socket
|   +-- ValueRefused             2   host.devices.device
|   +-- WorldSocketError         4   host.world.server
+-- IdentifierError              2   wire.identifiers             ValueError
+-- IdentifyError                1   recording.friction.sliding   ValueError
+-- LatencyError                 1   host.doctor.latency          RuntimeError
+-- LawError                     3   host.laws.laws
+-- LogError                     2   recording.log_files
+-- LslMissing                   2   lab.study.lsl
+-- MissingExtra                 2   recording.extras             ImportError
+-- MotionFileError              3   host.laws.path
+-- NeedsLinux                   4   system.c_library             ImportError
+-- NodeError                    2   sim_bus.server.live_nodes    ValueError
+-- NotRepeatable                2   host.run.run
+-- NotToTheRig                  7   cli.replay
+-- ParameterError               2   analysis.theory.operators    ValueError
+-- PcapngError                  2   recording.pcapng_blocks
+-- PortError                    2   monitor.forward
+-- RecordingError               2   recording.pcapng_blocks      OSError
+-- ReplayError                  2   lab.replay.host_replay
+-- RigError                     3   rigs.errors
+-- RunEnded                     n   host.commission.session
+-- SameBus                      2   sim_bus.server.bridge        ValueError
+-- ScriptError                  3   sim_bus.network.script       ValueError
+-- SilKitError                  4   sim_bus.server.silkit_interface
+-- SpanError                    2   recording.time_search
+-- StudyError                   3   lab.study.study              ValueError
+-- StudyFolderError             2   lab.study.study_folder       ValueError
+-- SweepError                   3   lab.sweep.sweep_file         ValueError
+-- SweepFolderError             2   lab.sweep.sweep_folder
+-- TableError                   3   recording.friction.columns   ValueError
+-- TruthError                   2   lab.virtual_course
+-- UnknownCase                  2   conformance.runner           ValueError
+-- UnknownSignal                2   recording.pdo_columns        KeyError
+-- WarmUpError                  2   lab.warm_up
+-- WebError                     2   monitor.web
+-- WrongCall                    2   rigs.arguments               TypeError
+-- WrongDevice                  3   conformance.runner
+-- WrongStep                    2   lab.study.session

Exceptions that are caught where they are raised, or next to it, are not listed: `tests/system/test_errors.py` has their
list, and compares the drawing with the classes.
"""

from __future__ import annotations

__all__ = ["CoulombusError"]


class CoulombusError(Exception):
    """An error that this project reports to its user; the text gives the problem and the remedy.

    Attributes
    ----------
    exit_status
        Exit status of a verb that the error ends (`coulombus.cli.errors`).
    """

    exit_status: int
