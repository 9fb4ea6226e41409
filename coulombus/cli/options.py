"""Options and arguments of the verbs, each declared once: with the parameter or the field that has its value.

    seconds: Annotated[float, option("How long to listen to a bus.", type=SECONDS, default=5.0)]

`with_options` makes click's parameters of a verb's. A parameter whose type is a dataclass is a value of several
options: its fields are declared in the same way. The declarations that several verbs have are below.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, Iterator, Mapping
from dataclasses import fields, is_dataclass
from functools import update_wrapper
from pathlib import Path
from typing import Annotated, Any, NamedTuple, TypeVar, get_args, get_origin, get_type_hints

import click

from coulombus.cli.option_types import SECONDS, UNCHECKED_PATH, InputPath, OutputFile

__all__ = [
    "ADAPTER",
    "BUS_VARIABLE",
    "MODES",
    "RIG_VARIABLE",
    "AnyBusOption",
    "BusOption",
    "BusesOption",
    "ChannelOption",
    "DisplaySecondsOption",
    "FaultsOption",
    "FileChannelOption",
    "IdsOption",
    "JsonLinesOption",
    "JsonOption",
    "LogEdsOption",
    "ModeOption",
    "OneChannelOption",
    "OptionalRecordingArgument",
    "OverwriteOption",
    "RecordOption",
    "RecordingArgument",
    "RigOption",
    "ScriptOption",
    "SeedOption",
    "SetOption",
    "SharedMachineOption",
    "SignalsOption",
    "SpanOption",
    "argument",
    "listed",
    "option",
    "with_adapter_options",
    "with_options",
    "words",
]

F = TypeVar("F", bound=Callable[..., Any])

MODES = ("active", "passive", "hybrid")
RIG_VARIABLE, BUS_VARIABLE = "COULOMBUS_RIG", "COULOMBUS_BUS"
"""Environment variables that are the defaults of --rig and --bus."""
ADAPTER_OPTIONS = f"{__name__}.adapter_options"
"""Key of a context: the values of --bus-option."""


class DeclaredOption(NamedTuple):
    """An option or an argument, with the attributes that click has for it."""

    click_decorator: Callable[..., Callable[[F], F]]
    flags: tuple[str, ...]
    attributes: Mapping[str, Any]

    @property
    def is_exposed(self) -> bool:
        """Whether its value is the verb's; else its callback keeps it."""
        return bool(self.attributes.get("expose_value", True))

    def on(self, name: str, verb: F) -> F:
        """Add it to a verb, whose parameter `name` has its value."""
        return self.click_decorator(*self.flags, *([name] if self.is_exposed else []), **self.attributes)(verb)


def option(*texts: str, **attributes: Any) -> DeclaredOption:
    """Declare an option by its flags, if any, and its help; without flags, the flag is that of the annotated name.

    A ``bool`` is a flag, a ``tuple[T, ...]`` may be given several times, and a default is shown.
    """
    *flags, help_text = texts
    shown = {"show_default": True} if attributes.get("default") not in (None, "") else {}
    return DeclaredOption(click.option, tuple(flags), {"help": help_text} | shown | attributes)


def argument(**attributes: Any) -> DeclaredOption:
    """Declare an argument."""
    return DeclaredOption(click.argument, (), attributes)


def _declared(hints: Iterable[tuple[str, Any]]) -> Iterator[tuple[str, DeclaredOption]]:
    """Yield the options of annotated names, with what name and type say of them."""
    for name, hint in hints:
        for declared in getattr(hint, "__metadata__", ()):
            if declared.click_decorator is click.argument:
                yield name, declared
                continue
            kind, implied = hint.__origin__, {}
            if kind is bool:
                implied = {"is_flag": True}
            elif get_origin(kind) is tuple and get_args(kind)[-1] is Ellipsis:
                implied = {"multiple": True}
            flags = declared.flags or (f"--{name.replace('_', '-')}",)
            yield name, DeclaredOption(click.option, flags, implied | declared.attributes)


def _options_of(values: type[Any]) -> list[tuple[str, DeclaredOption]]:
    """Return the options of a dataclass, in the order of its fields."""
    hints = get_type_hints(values, include_extras=True)
    return list(_declared((field.name, hints[field.name]) for field in fields(values)))


def with_options(function: F) -> F:
    """Add the options and arguments that a verb's parameters declare; their order is that of the help."""
    bundles: dict[str, tuple[type[Any], set[str]]] = {}
    options: list[tuple[str, DeclaredOption]] = []
    for name, hint in get_type_hints(function, include_extras=True).items():
        if is_dataclass(hint):
            bundled = _options_of(hint)  # type: ignore[arg-type]  # a class, not an instance
            bundles[name] = hint, {key for key, each in bundled if each.is_exposed}  # type: ignore[assignment]
            options += bundled
        else:
            options += _declared([(name, hint)])

    def verb(*args: Any, **values: Any) -> Any:
        for name, (bundle, keys) in bundles.items():
            values[name] = bundle(**{key: values.pop(key) for key in keys})
        return function(*args, **values)

    decorated: Any = update_wrapper(verb, function)
    for name, each in reversed(options):
        decorated = each.on(name, decorated)
    return decorated  # type: ignore[no-any-return]


def words(values: Any, kind: type[Any] | None = None, *, without: Collection[str] = ()) -> list[str]:
    """Return the command-line words of a dataclass of options, for another process.

    Parameters
    ----------
    kind : a base class of the dataclass, whose options alone are returned
    without : names of fields to leave out
    """
    texts: list[str] = []
    for name, declared in _options_of(kind or type(values)):
        value = None if name in without or not declared.is_exposed else getattr(values, name)
        if value is True:
            texts.append(declared.flags[0])
        elif value is not None and value is not False:
            for each in value if isinstance(value, tuple) else (value,):
                texts += [declared.flags[0], str(each).removesuffix(".0") if isinstance(each, float) else str(each)]
    return texts


def listed(texts: tuple[str, ...]) -> tuple[str, ...] | None:
    """Return the names of one or several options, or None."""
    return tuple(name.strip() for text in texts for name in text.split(",") if name.strip()) or None


def _keep_options(context: click.Context, param: click.Parameter, pairs: tuple[str, ...]) -> None:
    from coulombus.wire.address import AddressError, option_of

    for pair in pairs:
        try:
            option_of(pair)
        except AddressError as error:
            raise click.BadParameter(str(error), context, param) from None
    context.meta[ADAPTER_OPTIONS] = pairs


def with_adapter_options(context: click.Context, param: click.Parameter, bus_name: str | None) -> str | None:
    """Return the bus of --bus with the options of --bus-option: ``can:INTERFACE:CHANNEL?K=V&K=V``.

    Raises
    ------
    click.UsageError
        there are options, and no adapter
    """
    pairs = context.meta.get(ADAPTER_OPTIONS, ())
    if not pairs:
        return bus_name
    if bus_name is None or not bus_name.startswith("can:"):
        raise click.UsageError(
            f"--bus-option {pairs[0]} is of an adapter of python-can: give --bus can:INTERFACE:CHANNEL, or leave it out"
        )
    return f"{bus_name}{'&' if '?' in bus_name else '?'}{'&'.join(pairs)}"


def _span(context: click.Context, param: click.Parameter, text: str | None) -> tuple[float | None, float | None]:
    from coulombus.recording.time_search import parse_span

    try:
        return (None, None) if text is None else parse_span(text)
    except ValueError as error:
        raise click.BadParameter(str(error)) from None


RigOption = Annotated[
    str,
    option(
        "--rig",
        "A packaged rig (bench, paper, plane, two_axes) or the path of a rig file.",
        default="bench",
        envvar=RIG_VARIABLE,
        metavar="R",
    ),
]
SetOption = Annotated[
    tuple[str, ...],
    option(
        "--set",
        "Set any key of the rig file, as in --set plant.inertia_kg_m2=3e-3. May be given several times.",
        metavar="SECTION.KEY=V",
    ),
]
ModeOption = Annotated[
    str, option("--mode", "The device that displays the friction.", type=click.Choice(MODES), default="hybrid")
]
DisplaySecondsOption = Annotated[
    float | None, option("--seconds", "Duration of the display.  [default: the rig's schedule]", type=SECONDS)
]
SeedOption = Annotated[int, option("--seed", "Random seed.", type=click.IntRange(min=0), default=0)]
SharedMachineOption = Annotated[
    bool, option("--shared-machine", "Relaxed time limits, for simulated nodes on a busy machine.")
]
FaultsOption = Annotated[
    Path | None,
    option(
        "--faults",
        "A fault file: what goes wrong on the bus, and when.",
        type=UNCHECKED_PATH,
        metavar="F.toml",
    ),
]
ScriptOption = Annotated[
    Path | None,
    option(
        "--script",
        "Switch nodes off and on, reset them, let device faults come and go at given times.",
        type=UNCHECKED_PATH,
        metavar="F.toml",
    ),
]

BusOption = Annotated[
    str | None,
    option("--bus", "coulombus:NAME or socketcan:IF.  [default: coulombus:RIG]", envvar=BUS_VARIABLE, metavar="B"),
]
ADAPTER = option(
    "--bus-option",
    "Option of an adapter, as python-can names it: bitrate=500000. May be given several times.",
    multiple=True,
    is_eager=True,
    expose_value=False,
    callback=_keep_options,
    metavar="K=V",
)
AnyBusOption = Annotated[
    str | None,
    option(
        "--bus",
        "coulombus:NAME, socketcan:IF or can:INTERFACE:CHANNEL.  [default: coulombus:RIG]",
        envvar=BUS_VARIABLE,
        metavar="B",
        callback=with_adapter_options,
    ),
    ADAPTER,
]
BusesOption = Annotated[
    tuple[str, ...],
    option(
        "--bus",
        "coulombus:NAME or socketcan:IF; CHANNEL=B for each bus of a rig with several.  [default: coulombus:RIG]",
        envvar=BUS_VARIABLE,
        metavar="B",
    ),
]
ChannelOption = Annotated[
    str | None,
    option(
        "--channel", "Only the axes on this bus, of a rig with several.  [default: all, one process each]", metavar="C"
    ),
]
OneChannelOption = Annotated[str | None, option("--channel", "Bus of a rig, or of a file, with several.", metavar="C")]

RecordingArgument = Annotated[Path, argument(type=InputPath())]
OptionalRecordingArgument = Annotated[Path | None, argument(required=False, type=InputPath())]
FileChannelOption = Annotated[
    tuple[str, ...],
    option("--channel", "Bus of a file with several; RIG_BUS=NAME for a rig with several.", metavar="NAME"),
]
LogEdsOption = Annotated[
    tuple[str, ...],
    option(
        "--eds",
        "EDS file of node N, as 5=drive.eds; or a folder of them. May be given several times.",
        metavar="N=FILE",
    ),
]
SignalsOption = Annotated[
    tuple[str, ...] | None,
    option(
        "--signals",
        "Only these signals, by their names.  [default: all]",
        multiple=True,
        callback=lambda ctx, param, texts: listed(texts),
        metavar="A,B",
    ),
]
SpanOption = Annotated[
    tuple[float | None, float | None],
    option("From A to B, in s, as 3:5, 2.5: or :10.  [default: all]", callback=_span, metavar="A:B"),
]
IdsOption = Annotated[
    str | None, option("--ids", "Only these identifiers, hexadecimal: 181,200-27F,00000123x.", metavar="IDS")
]

RecordOption = Annotated[
    Path | None,
    option("--record", "Record every frame there, in a new file.", type=OutputFile(".pcapng"), metavar="F.pcapng"),
]
OverwriteOption = Annotated[bool, option("--overwrite", "--force", "Overwrite existing files.", is_eager=True)]
JsonOption = Annotated[bool, option("--json", "Print the result as JSON to stdout.")]
JsonLinesOption = Annotated[bool, option("--json", "One JSON object a line to stdout.")]
