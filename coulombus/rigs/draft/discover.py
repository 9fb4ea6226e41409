"""Choose the devices of a draft: those that the user names, and those that answered on a bus, with their EDS files."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from importlib import resources
from pathlib import Path

from coulombus.eds.eds_folder import fitting, read_folder
from coulombus.eds.own_devices import identity_from_1018h, packaged
from coulombus.eds.reader import Description, read_eds
from coulombus.rigs.draft.device import DraftDevice, Place
from coulombus.rigs.errors import RigError
from coulombus.rigs.roles import CIA401, CIA402, CIA404
from coulombus.rigs.signals import Node

__all__ = ["DeviceChoice", "gather"]

OWN = "bench"
"""The word for the project's own device, and its file in the package."""
OWN_FILES = {"motor": "motor.eds", "brake": "mr_brake.eds"}
OUTPUTS, INPUTS = (0x7300, 0x9300, 0x6411), (0x7130, 0x9130, 0x6401)
LAST = 127
Answered = Mapping[int, Mapping[Place, int]]
"""Object values of live nodes, by node id."""


@dataclass(frozen=True)
class DeviceChoice:
    """The user's choice of a device: its EDS file ("bench": the project's own; "": a node that answers on the bus), its
    node id, and its axis of a drive.
    """

    node: Node
    eds: str = ""
    node_id: int | None = None
    axis: int = 1


@dataclass
class _Gathering:
    """Collects the devices of a draft.

    Attributes
    ----------
    folder : of the rig file, None where it is not known
    left : live nodes that are not assigned to a device
    files : EDS files for live nodes, by identity
    """

    folder: Path | None
    left: dict[int, Mapping[Place, int]]
    files: Sequence[Description]
    node_ids: set[int] = field(default_factory=set)

    def named(self, choice: DeviceChoice) -> DraftDevice:
        """Return a device whose EDS file is named."""
        name, description = self._read(choice)
        node_id = choice.node_id or self._live_id(description) or description.node_id
        if not node_id or (choice.node_id is None and node_id in self.node_ids):
            first = {"motor": 1, "brake": 2}.get(choice.node, 3)
            node_id = next(number for number in (*range(first, LAST), *range(1, first)) if number not in self.node_ids)
        self.node_ids.add(node_id)
        return DraftDevice(choice.node, description, name, node_id, self.left.pop(node_id, {}), choice.axis)

    def _read(self, choice: DeviceChoice) -> tuple[str, Description]:
        if choice.eds == OWN and choice.node in OWN_FILES:
            name = OWN_FILES[choice.node]
            packaged = Path(str(resources.files("coulombus.eds") / name))
            beside = self.folder is not None and (self.folder / name).exists()  # it would be read instead
            return str(packaged) if beside else name, read_eds(packaged)
        return self._name(Path(choice.eds)), read_eds(choice.eds)

    def _name(self, path: Path) -> str:
        """Return a file's name for the rig file: relative to its folder, unless they share only the root."""
        whole = path.resolve()
        if self.folder is None or os.path.commonpath((whole, self.folder)) == os.sep:
            return str(whole)
        return os.path.relpath(whole, self.folder)

    def _live_id(self, description: Description) -> int:
        identity = identity_from_1018h(description)
        return next(
            (node for node, answers in self.left.items() if any(identity) and _identity(answers) == identity), 0
        )

    def live(self, node: Node, node_id: int) -> DraftDevice:
        """Return a device that answered on the bus."""
        answers = self.left.pop(node_id)
        description = self.file_of(answers)
        if description is None:
            vendor, product = _identity(answers)
            text = f"node {node_id} has 1018h {vendor:#010x} {product:#010x}, and"
            if self.files:
                text += f" none of {len(self.files)} EDS files in the folder has it; put its maker's file there"
            else:
                text += " it has no EDS file here; put its maker's file into a folder, give it with --eds-folder"
            raise RigError([f"{text}, or name it with --drive, --brake or --sensor"])
        self.node_ids.add(node_id)
        return DraftDevice(node, description, self._name_of(description), node_id, answers)

    def _name_of(self, description: Description) -> str:
        """Return an EDS file's name for the rig file; files of the package have short names."""
        path = Path(description.path)
        beside = self.folder is not None and (self.folder / path.name).exists()  # it would be read instead
        return path.name if description in packaged() and not beside else self._name(path)

    def file_of(self, answers: Mapping[Place, int]) -> Description | None:
        """Return the EDS file of a live node from the folder or the package, else None."""
        identity, revision = _identity(answers), answers.get((0x1018, 3), 0)
        return fitting(self.files, identity, revision) or fitting(packaged(), identity, revision)

    def with_objects(self, indices: Sequence[int]) -> list[int]:
        """Return the live nodes of CiA 404 and 401 whose EDS file has one of these arrays."""
        descriptions = {node_id: self.file_of(answers) for node_id, answers in self.left.items()}
        return [
            node_id
            for node_id, description in descriptions.items()
            if _profile(self.left[node_id]) in (CIA404, CIA401)
            and description is not None
            and any(description.has(index, 1) for index in indices)
        ]

    def motor(self) -> int:
        """Return the live node to use as the motor's drive."""
        return self._of_profile("a drive (CiA 402)", CIA402)

    def brake(self) -> int:
        """Return the live node to use as the brake's driver: a node with an analogue output, else a second drive."""
        drivers = self.with_objects(OUTPUTS)
        if drivers:
            return drivers[0]
        return self._of_profile("a brake's driver (CiA 404, CiA 401 with an output, or a second drive)", CIA402)

    def _of_profile(self, what: str, profile: int) -> int:
        for node_id, answers in self.left.items():
            if _profile(answers) == profile:
                return node_id
        raise RigError([f"no node on the bus is {what}; name one by its EDS file (--drive, --brake)"])


def gather(
    choices: Sequence[DeviceChoice],
    folder: Path | None,
    answered: Answered | None = None,
    eds_folder: Path | None = None,
) -> tuple[DraftDevice, ...]:
    """Return motor, brake and sensors.

    Parameters
    ----------
    choices : motor, brake, sensors; a motor or brake without a file is chosen from the live nodes
    folder : of the new rig file, None if unknown
    answered : object values of live nodes
    eds_folder : with the EDS files of live nodes

    Raises
    ------
    EdsError
        a file cannot be read
    RigError
        a live node is missing, or has no EDS file in the folder
    """
    all_files = () if eds_folder is None else tuple(read_folder(eds_folder)[0])
    here = _Gathering(folder, dict(answered or {}), all_files)
    here.node_ids |= {choice.node_id for choice in choices if choice.node_id is not None}
    devices = {choice.node: here.named(choice) for choice in choices if choice.eds}
    for choice in choices:
        if not choice.eds:
            node_id = choice.node_id or (here.motor() if choice.node == "motor" else here.brake())
            if node_id not in here.left:
                raise RigError([f"node {node_id}, which is to be the {choice.node}, did not answer on the bus"])
            devices[choice.node] = replace(here.live(choice.node, node_id), axis=choice.axis)
    for node_id in here.with_objects(INPUTS):
        devices[f"sensor{node_id}"] = here.live(f"sensor{node_id}", node_id)
    return (devices.pop("motor"), devices.pop("brake"), *devices.values())


def _identity(answers: Mapping[Place, int]) -> tuple[int, int]:
    return answers.get((0x1018, 1), 0), answers.get((0x1018, 2), 0)


def _profile(answers: Mapping[Place, int]) -> int:
    return answers.get((0x1000, 0), 0) & 0xFFFF
