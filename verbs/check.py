"""``coulombus check``: a rig file and everything that follows from it."""

from __future__ import annotations

import click

from coulombus.verbs.common import EXIT_STATUS, errors, json_option, load, print_json, rig_option, set_option, verdict

__all__ = ["check"]


@click.command(epilog=EXIT_STATUS)
@rig_option
@set_option
@json_option
def check(rig_name: str, overrides: tuple[str, ...], as_json: bool) -> None:
    """Check a rig file, its EDS files, its PDO layout, what bring-up will set, and whether a cycle fits on the bus; nothing is run.

    A line "FAIL" is what bring-up would refuse: an object that is missing, read-only or too narrow for its value, another identity, or a
    limit that would cut the law off.
    "lost" is what bring-up leaves out, as the device is not ours or has no such object; "open" is what the device itself is asked.

    \b
    Examples:
      coulombus check --rig my-rig.toml
      coulombus check --rig bench --set bus.bitrate_bit_s=500000
    """
    with errors():
        from coulombus.host.cycle.controller import Controller
        from coulombus.host.cycle.demand import cut_off
        from coulombus.host.laws.laws import OWN_LAWS
        from coulombus.host.setup.device_plan import DevicePlan, device_plans
        from coulombus.rigs.plan.rig_plan import plans

        rig = load(rig_name, overrides)
        diagnoses = [str(d) for node in rig.nodes for d in node.description.diagnoses]
        buses = plans(rig)
        fits = all(planned.fits for planned in buses.values())
        planned = next((planned for planned in buses.values() if not planned.fits), buses[rig.channels[0]])
        limits: dict[str, int] = {}
        devices: list[DevicePlan] = []
        for axis in rig.axes:
            for mode in axis.mode:
                limit_pm = int(Controller(axis, mode).control["motor_limit_pm"][0])
                limits[axis.prefix + mode] = limit_pm
                devices += device_plans(axis, mode, limit_pm)
        problems = [
            *dict.fromkeys(text for device in devices for text in device.problems)
        ]  # each mode has its own limit
        questions = [*dict.fromkeys(text for device in devices for text in device.questions)]
        losses = [*dict.fromkeys(text for device in devices for text in device.losses)]
        cut = list(dict.fromkeys(text for mode in rig.modes for text in cut_off(rig, mode)))
        with verdict(0 if fits and not problems and not cut else 1):
            if as_json:
                print_json(
                    {
                        "rig": rig.name,
                        "cut_off": cut,
                        "diagnoses": diagnoses,
                        "bitrate_bit_s": planned.timing.bitrate_bit_s,
                        "period_s": planned.timing.period_ns * 1e-9,
                        "busy_s": planned.busy_ns * 1e-9,
                        "utilisation": planned.busy_ns / planned.timing.period_ns,
                        "fits": fits,
                        "late": list(planned.reasons),
                        "latest_rpdo_s": planned.latest_rpdo_ns * 1e-9,
                        "motor_limit_per_mille": limits,
                        "problems": problems,
                        "questions": questions,
                        "losses": losses,
                        "frames": [
                            {"name": m.name, "can_id": m.can_id, "bytes": m.length, "bits": m.bits}
                            for one in buses.values()
                            for m in one.cyclic
                        ],
                    }
                )
            else:
                for text in diagnoses:
                    click.echo(text)
                for pdo in rig.pdos():
                    click.echo(
                        f"\n{pdo.node} {pdo.name}, COB-ID {pdo.layout.cob_id:03X}h, "
                        f"transmission type {pdo.layout.transmission}"
                    )
                    click.echo(pdo.layout.diagram())
                    for signal in pdo.signals:
                        click.echo(
                            f"  {signal.name:<28} = raw x {signal.scale:.9g}"
                            + (f" {signal.unit}" if signal.unit else "")
                        )
                for planned in buses.values():
                    click.echo(f"\nworst case on the wire at {planned.timing.bitrate_bit_s / 1e6:g} Mbit/s:")
                    for m in planned.cyclic:
                        click.echo(f"  {m.can_id:03X}h  {m.name:<14} {m.length} bytes  {m.bits:>4} bits")
                    busy, period = planned.busy_ns, planned.timing.period_ns
                    click.echo(f"  together {busy / 1e3:.0f} us of each {period / 1e3:.0f} us: {busy / period:.1%}")
                    click.echo(
                        f"  the latest RPDO is through {planned.latest_rpdo_ns / 1e3:.0f} us after SYNC (coulombus plan)"
                    )
                for mode, limit in limits.items():
                    click.echo(f"mode {mode}: drive torque limit 6072h = {limit} per mille")
                if rig.law_function.strip() not in OWN_LAWS:
                    click.echo(
                        f"law {rig.law_function}: what a limit cuts off of it is not known before it runs; the run tells"
                    )
                for text in losses:
                    click.echo(f"lost: {text}")
                for text in questions:
                    click.echo(f"open: {text}")
                for text in (*problems, *cut):
                    click.echo(f"FAIL: {text}")
                for planned in buses.values():
                    if not planned.fits:
                        click.echo(f"FAIL: {planned.verdict()}")
                if fits and not problems and not cut:
                    click.echo("ok, if the devices answer what is open above" if questions else "ok")
