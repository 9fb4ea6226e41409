"""Files for host, simulation and bridge as services: systemd units, device rules, limits, CAN set-up.

The host's unit never restarts: after a trip nothing re-arms by itself, and a person must start it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from coulombus.system.quoting import extended_regex, interface_name, shell, systemd_program, systemd_word, unit_name
from coulombus.wire.address import parse_address

__all__ = ["UnitSettings", "files"]

USER, GROUP = "coulombus", "realtime"
WATCHDOG_S, SIM_WATCHDOG_S = 5, 10
START_S = 300
"""Time-out of the start: the first start compiles."""
SAFE_S = 30
"""Time for the safe end, in addition to the brake's hold and ramp."""
STATUSES = "143 130 129"
"""Exit statuses of SIGTERM, SIGINT and SIGHUP, each after a safe end."""

USB_DRIVERS = "gs_usb|peak_usb|kvaser_usb|ems_usb|esd_usb|mcba_usb|usb_8dev|etas_es58x|ucan"

HARDENED = """\
NoNewPrivileges=yes
CapabilityBoundingSet=
AmbientCapabilities=
ProtectSystem=strict
ProtectHome={home}
PrivateTmp=yes
ProtectClock=yes
ProtectControlGroups=yes
ProtectHostname=yes
ProtectKernelLogs=yes
ProtectKernelModules=yes
ProtectKernelTunables=yes
ProtectProc=invisible
LockPersonality=yes
RemoveIPC=yes
RestrictNamespaces=yes
RestrictSUIDSGID=yes
RestrictAddressFamilies=AF_UNIX AF_CAN AF_NETLINK
IPAddressDeny=any
SystemCallArchitectures=native
SystemCallFilter=@system-service
SystemCallErrorNumber=EPERM
KeyringMode=private
DevicePolicy=closed
UMask=0027
# not set: MemoryDenyWriteExecute (kernels are compiled), RestrictRealtime (SCHED_FIFO)
"""
USER_HARDENED = """\
NoNewPrivileges=yes
LockPersonality=yes
RestrictSUIDSGID=yes
SystemCallArchitectures=native
UMask=0027
"""


@dataclass(frozen=True)
class UnitSettings:
    """Settings of the units.

    Attributes
    ----------
    program : the command that starts `coulombus`
    rig : a packaged rig's name, or the path of a rig file
    bus : the bus of the host
    mode : mode of the display
    bitrate_bit_s : bit rate of the CAN interface
    ending_s : longest time of the brake's hold and ramp
    user : whether the units are for a user's service manager, not the system's
    bridge : whether a virtual bus is joined with a CAN interface
    """

    program: Sequence[str]
    rig: str
    bus: str
    mode: str
    bitrate_bit_s: int
    ending_s: float
    user: bool = False
    bridge: bool = False

    @property
    def on_interface(self) -> bool:
        """Whether the host or the bridge is on a CAN interface."""
        return self.bridge or parse_address(self.bus).is_interface

    @property
    def interface(self) -> str:
        """The CAN interface: the host's, or can0 if the host is on a virtual bus.

        AddressError: the name of the bus cannot be used in these files.
        """
        address = parse_address(self.bus)
        return interface_name(address.name) if address.is_interface else "can0"

    def typed(self, *words: str) -> str:
        """Return a command as a person types it: with the program's path, which sudo's PATH does not have."""
        return " ".join(map(shell, (*self.program, *words)))

    def command(self, *words: str) -> str:
        """Return a value of ExecStart."""
        program, *first = self.program
        return " ".join((systemd_program(program), *map(systemd_word, (*first, *words))))


def files(service: UnitSettings) -> dict[str, str]:
    """Return the files by their names; files other than units only for the system's manager, and those of a CAN
    interface only where one is used.
    """
    name = service.interface
    units = {"coulombus-host.service": _host(service), "coulombus-sim.service": _sim(service)}
    if service.on_interface:
        units["coulombus-bridge.service"] = _bridge(service)
    if service.user:
        return units | {"INSTALL.txt": USER_INSTALL.format(doctor=service.typed("doctor"))}
    units |= {
        "coulombus-sysusers.conf": SYSUSERS,
        "coulombus-tmpfiles.conf": TMPFILES,
        "90-coulombus-limits.conf": LIMITS,
    }
    devices, start = "", "coulombus-sim coulombus-host"
    if service.on_interface:
        devices, start = DEVICES.format(name=name), "coulombus-host"
        irqs = shell(f"^irq/[0-9]+-{extended_regex(name)}$")
        units |= {
            "90-coulombus.rules": RULES,
            f"80-coulombus-{name}.network": _network(name, service.bitrate_bit_s),
            f"80-coulombus-{name}.link": LINK.format(name=name),
            f"{name}-up.sh": UP.format(name=shell(name), rate=service.bitrate_bit_s, irqs=irqs),
        }
    stop = f"sudo -u {USER} env XDG_RUNTIME_DIR=/run/coulombus {service.typed('stop')}"
    return units | {"INSTALL.txt": INSTALL.format(devices=devices, start=start, stop=stop)}


def _unit(
    service: UnitSettings,
    what: str,
    command: str,
    lines: str,
    after: str = "",
    *,
    restart: bool,
    watchdog_s: int,
    priority: int,
) -> str:
    target = "default.target" if service.user else "multi-user.target"
    home = (
        "tmpfs"
        if service.rig.find("/") < 0 and not service.program[0].startswith(("/home/", "/root/"))
        else "read-only"
    )
    hardening = USER_HARDENED if service.user else HARDENED.format(home=home)
    who = "" if service.user else f"User={USER}\nGroup={USER}\nSupplementaryGroups={GROUP}\n"
    places = (
        ""
        if service.user
        else "Environment=XDG_RUNTIME_DIR=/run/coulombus NUMBA_CACHE_DIR=/var/cache/coulombus MPLCONFIGDIR=/var/cache/coulombus\n"
        "StateDirectory=coulombus\nCacheDirectory=coulombus\nReadWritePaths=/run/coulombus\nWorkingDirectory=/var/lib/coulombus\n"
    )
    limits = f"LimitRTPRIO={priority}\nLimitMEMLOCK=infinity\nLimitCORE=0\n"
    again = "Restart=on-failure\nRestartSec=2\n" if restart else ""
    install = f"\n[Install]\nWantedBy={target}\n" if restart else ""
    return (
        f"# made by `coulombus systemd`\n[Unit]\nDescription={what}\nDocumentation=man:systemd.service(5)\n{after}\n"
        f"[Service]\nType=notify\nNotifyAccess=main\nExecStart={command}\nWatchdogSec={watchdog_s}\n"
        f"TimeoutStartSec={START_S}\n{again}{lines}{who}{places}{limits}{hardening}{install}"
    )


def _host(service: UnitSettings) -> str:
    after = raised = ""
    if service.bus.startswith("socketcan:") and not service.user:
        device = f"sys-subsystem-net-devices-{unit_name(service.interface)}.device"
        after = f"After={device}\nBindsTo={device}\n"
        irqs = shell(f"^irq/[0-9]+-{extended_regex(service.interface)}$")
        raised = RAISED.format(script=systemd_word(RAISE_SCRIPT.format(irqs=irqs)))
    else:
        after = "After=coulombus-sim.service\n"
    stop_s = round(SAFE_S + service.ending_s)
    lines = (
        f"SuccessExitStatus={STATUSES}\n"
        "# never restarted: after a trip nothing re-arms by itself\nRestart=no\n"
        "# the data plane makes the rig safe by itself, whatever ends its parent: it is given the time\n"
        f"KillMode=control-group\nTimeoutStopSec={stop_s}\nOOMScoreAdjust=-900\n"
    )
    if service.user:
        lines = lines.replace("OOMScoreAdjust=-900\n", "")  # only the system's manager may set it
    else:
        lines += f"{raised}DeviceAllow=/dev/cpu_dma_latency rw\n"
        lines += "# the dead man's switch, where host.deadman is a GPIO line\nDeviceAllow=char-gpiochip r\n"
    recorded = () if service.user else ("--record", "runs", "--rotate", "1h", "--keep", "20GB")
    command = service.command("run", "--rig", service.rig, "--bus", service.bus, "--mode", service.mode, *recorded)
    return _unit(
        service,
        "Coulombus: the host on the rig",
        command,
        lines,
        after,
        restart=False,
        watchdog_s=WATCHDOG_S,
        priority=95,
    )


def _sim(service: UnitSettings) -> str:
    bus = [] if service.bus.startswith("socketcan:") else ["--bus", service.bus]
    command = service.command("emulate", "--rig", service.rig, *bus)
    lines = "TimeoutStopSec=10\n" + ("" if service.user else "DeviceAllow=/dev/cpu_dma_latency rw\n")
    what = "Coulombus: a virtual bus with the simulated rig"
    return _unit(service, what, command, lines, restart=True, watchdog_s=SIM_WATCHDOG_S, priority=95)


def _bridge(service: UnitSettings) -> str:
    virtual = service.bus if service.bus.startswith("coulombus:") else "coulombus:bench"
    command = service.command("bridge", virtual, f"socketcan:{service.interface}")
    what = "Coulombus: a virtual bus and a CAN interface as one"
    after = "After=coulombus-sim.service\n"
    return _unit(
        service, what, command, "TimeoutStopSec=10\n", after, restart=True, watchdog_s=SIM_WATCHDOG_S, priority=0
    )


def _network(name: str, rate: int) -> str:
    return (
        f"# made by `coulombus systemd`\n[Match]\nName={name}\n\n[CAN]\nBitRate={rate}\nSamplePoint=87.5%\n"
        "RestartSec=100ms\nBusErrorReporting=yes\n"
    )


LINK = """\
# made by `coulombus systemd`
[Match]
OriginalName={name}

[Link]
TransmitQueueLength=64
"""
RAISED = """\
# on a PREEMPT_RT kernel the card's interrupt is a thread, of priority 50 each time the interface comes up
ExecStartPre=+-/bin/sh -c {script}
"""
RAISE_SCRIPT = 'for pid in $(pgrep {irqs}); do chrt -f -p 90 "$pid"; done'
UP = """\
#!/bin/sh
# made by `coulombus systemd`: the same by hand, where systemd-networkd does not run
set -eu
ip link set {name} down
ip link set {name} type can bitrate {rate} sample-point 0.875 restart-ms 100
ip link set {name} type can berr-reporting on || true  # not every card can
ip link set {name} txqueuelen 64 up
for pid in $(pgrep {irqs}); do chrt -f -p 90 "$pid"; done  # PREEMPT_RT: before the host
"""
SYSUSERS = f"""\
# made by `coulombus systemd`
g {GROUP} - -
u {USER} - "Coulombus" /var/lib/coulombus
m {USER} {GROUP}
"""
TMPFILES = f"""\
# made by `coulombus systemd`: sockets of the virtual buses and of the host, recordings
d /run/coulombus 0700 {USER} {USER} -
d /var/lib/coulombus 0750 {USER} {USER} -
"""
LIMITS = f"""\
# made by `coulombus systemd`: for people who run the host by hand
@{GROUP}  -  rtprio   95
@{GROUP}  -  memlock  unlimited
"""
RULES = f"""\
# made by `coulombus systemd`: the CPUs stay awake while the host runs, and the port of a CAN card
KERNEL=="cpu_dma_latency", GROUP="{GROUP}", MODE="0660"
ACTION=="bind", SUBSYSTEM=="usb", DRIVER=="{USB_DRIVERS}", ATTR{{../power/control}}="on"
"""
INSTALL = """\
Read each file first; then, as root in this folder:

    cp coulombus-sysusers.conf /etc/sysusers.d/coulombus.conf && systemd-sysusers
    cp coulombus-tmpfiles.conf /etc/tmpfiles.d/coulombus.conf && systemd-tmpfiles --create
    cp 90-coulombus-limits.conf /etc/security/limits.d/
{devices}    cp *.service /etc/systemd/system/ && systemctl daemon-reload
    systemctl start {start}  # a person does this; the host is never enabled

To stop the running host, as its user:

    {stop}
"""
DEVICES = """\
    cp 90-coulombus.rules /etc/udev/rules.d/ && udevadm control --reload && udevadm trigger
    cp 80-coulombus-{name}.network 80-coulombus-{name}.link /etc/systemd/network/
    networkctl reload                    # or, without systemd-networkd: sh {name}-up.sh
"""
USER_INSTALL = """\
Read each file first; then:

    cp *.service ~/.config/systemd/user/ && systemctl --user daemon-reload
    systemctl --user start coulombus-sim coulombus-host

Real-time priority and locked memory are limited to what this user has:

    {doctor}
"""
