"""System calls for kernels, and flags that a kernel shares with Python.

Kernels call the C library by symbol names (numba's ``ExternalFunction``), which the disk cache
keeps; it would not keep pointers of ctypes and cffi. A missing symbol would crash at the first
call, so the names are checked on import. Addresses are plain integers (``array.ctypes.data``). All
results are int64; -1 means: see `errno`.

With NUMBA_DISABLE_JIT=1 the same names are ctypes calls, so that kernels also run as plain Python.

`load_acquire` and `store_release` work on an int64 at an address: an ordinary read of a flag would
be hoisted out of the loop.
"""

from __future__ import annotations

import ctypes
import os
import time
from typing import Any

from coulombus.kernels.decorator import JIT_DISABLED
from coulombus.system.c_library import NeedsLinux, c_library

__all__ = [
    "CLOCK_MONOTONIC",
    "CLOCK_REALTIME",
    "CLOCK_THREAD_CPUTIME_ID",
    "EAGAIN",
    "EBADF",
    "ECONNRESET",
    "EINTR",
    "ENETDOWN",
    "ENOBUFS",
    "ENODEV",
    "ENOMEM",
    "ENXIO",
    "EPIPE",
    "EPOLLERR",
    "EPOLLHUP",
    "EPOLLIN",
    "EPOLL_CTL_DEL",
    "MSG_CTRUNC",
    "MSG_DONTWAIT",
    "MSG_NOSIGNAL",
    "MSG_TRUNC",
    "POLLERR",
    "POLLHUP",
    "POLLIN",
    "POLLNVAL",
    "clock_ns",
    "epoll_ctl",
    "epoll_wait",
    "errno",
    "getppid",
    "load_acquire",
    "now_ns",
    "ppoll_ns",
    "read",
    "recv",
    "recvmsg",
    "send",
    "sleep_until",
    "store_release",
    "write",
]

CLOCK_REALTIME, CLOCK_MONOTONIC, CLOCK_THREAD_CPUTIME_ID = 0, 1, 3
MSG_CTRUNC, MSG_TRUNC, MSG_DONTWAIT, MSG_NOSIGNAL = 0x8, 0x20, 0x40, 0x4000
EINTR, ENXIO, EBADF, EAGAIN, ENOMEM, ENODEV, EPIPE = 4, 6, 9, 11, 12, 19, 32
ENETDOWN, ECONNRESET, ENOBUFS = 100, 104, 105
POLLIN, POLLERR, POLLHUP, POLLNVAL = 0x1, 0x8, 0x10, 0x20
EPOLLIN, EPOLLERR, EPOLLHUP, EPOLL_CTL_DEL = 0x1, 0x8, 0x10, 2
TIMER_ABSTIME = 1
SECOND_NS = 1_000_000_000

_SYMBOLS = (
    *("__errno_location", "clock_gettime", "clock_nanosleep", "epoll_ctl", "epoll_wait", "getppid"),
    *("ppoll", "read", "recv", "recvmsg", "send", "write"),
)
_library = c_library()
_missing = [name for name in _SYMBOLS if not hasattr(_library, name)]
if _missing:
    raise NeedsLinux(", ".join(_missing))


if JIT_DISABLED:
    _c = {name: getattr(_library, name) for name in _SYMBOLS}
    for _function in _c.values():
        _function.restype = ctypes.c_ssize_t
    for _name in ("clock_nanosleep", "epoll_ctl", "epoll_wait", "ppoll"):
        _c[_name].restype = ctypes.c_int

    def load_acquire(address: int) -> int:
        """Read the int64 at `address` with acquire order: earlier writes of its writer are visible, too."""
        return ctypes.c_int64.from_address(address).value

    def store_release(address: int, value: int) -> None:
        """Write the int64 at `address` with release order: earlier writes become visible with it."""
        ctypes.c_int64.from_address(address).value = value

    def errno() -> int:
        """Return the calling thread's error number."""
        return ctypes.get_errno()

    def getppid() -> int:
        """Return the id of this process's parent; it changes when the parent ends."""
        return os.getppid()

    def clock_ns(clock: int) -> int:
        """Return the time of the clock `clock` in ns."""
        return time.clock_gettime_ns(clock)

    def now_ns() -> int:
        """Return CLOCK_MONOTONIC in ns."""
        return time.monotonic_ns()

    def sleep_until(t_ns: int) -> int:
        """Sleep until CLOCK_MONOTONIC = `t_ns`.

        Return 0, or the error number (EINTR: interrupted by a signal).
        """
        spec = (ctypes.c_int64 * 2)(t_ns // SECOND_NS, t_ns % SECOND_NS)
        return int(_c["clock_nanosleep"](CLOCK_MONOTONIC, TIMER_ABSTIME, spec, None))

    def ppoll_ns(address: int, count: int, timeout_ns: int) -> int:
        """Wait for the `count` struct pollfd at `address`, at most `timeout_ns` (negative: for ever); return
        the number of ready descriptors.
        """
        spec = (ctypes.c_int64 * 2)(timeout_ns // SECOND_NS, timeout_ns % SECOND_NS) if timeout_ns >= 0 else None
        return int(_c["ppoll"](ctypes.c_void_p(int(address)), ctypes.c_ulong(int(count)), spec, None))

    def read(fd: int, address: int, size: int) -> int:
        """read(2)."""
        return int(_c["read"](int(fd), ctypes.c_void_p(int(address)), ctypes.c_size_t(int(size))))

    def write(fd: int, address: int, size: int) -> int:
        """write(2)."""
        return int(_c["write"](int(fd), ctypes.c_void_p(int(address)), ctypes.c_size_t(int(size))))

    def send(fd: int, address: int, size: int, flags: int) -> int:
        """send(2)."""
        return int(_c["send"](int(fd), ctypes.c_void_p(int(address)), ctypes.c_size_t(int(size)), int(flags)))

    def recv(fd: int, address: int, size: int, flags: int) -> int:
        """recv(2)."""
        return int(_c["recv"](int(fd), ctypes.c_void_p(int(address)), ctypes.c_size_t(int(size)), int(flags)))

    def recvmsg(fd: int, address: int, flags: int) -> int:
        """recvmsg(2) into the struct msghdr at `address` (see `wire.recvmsg`)."""
        return int(_c["recvmsg"](int(fd), ctypes.c_void_p(int(address)), int(flags)))

    def epoll_wait(fd: int, address: int, count: int, timeout_ms: int) -> int:
        """epoll_wait(2)."""
        return int(_c["epoll_wait"](int(fd), ctypes.c_void_p(int(address)), int(count), int(timeout_ms)))

    def epoll_ctl(fd: int, operation: int, target: int, address: int) -> int:
        """epoll_ctl(2)."""
        return int(_c["epoll_ctl"](int(fd), int(operation), int(target), ctypes.c_void_p(int(address))))

else:
    from llvmlite import ir
    from numba import types
    from numba.extending import intrinsic

    _I32, _I64 = ir.IntType(32), ir.IntType(64)
    _NULL = ir.Constant(_I64, 0)

    def _call(builder: Any, name: str, result: Any, arguments: list[Any]) -> Any:
        """Call the symbol `name`; return its result as an int64."""
        shape = ir.FunctionType(result, [a.type for a in arguments])
        symbol = builder.module.globals.get(name)
        value = builder.call(symbol or ir.Function(builder.module, shape, name), arguments)
        return value if result == _I64 else builder.sext(value, _I64)

    def _room(builder: Any) -> Any:
        """Return the address of a struct timespec on the stack, allocated once even if called in a loop."""
        with builder.goto_entry_block():
            return builder.alloca(ir.ArrayType(_I64, 2))

    def _timespec(builder: Any, t_ns: Any) -> Any:
        """Return the address of a struct timespec on the stack that holds `t_ns` >= 0."""
        spec = _room(builder)
        zero, second = ir.Constant(_I32, 0), ir.Constant(_I64, SECOND_NS)
        builder.store(builder.sdiv(t_ns, second), builder.gep(spec, [zero, zero]))
        builder.store(builder.srem(t_ns, second), builder.gep(spec, [zero, ir.Constant(_I32, 1)]))
        return builder.ptrtoint(spec, _I64)

    def _clock(builder: Any, clock: Any) -> Any:
        spec = _room(builder)
        _call(builder, "clock_gettime", _I32, [clock, builder.ptrtoint(spec, _I64)])
        zero = ir.Constant(_I32, 0)
        seconds = builder.load(builder.gep(spec, [zero, zero]))
        rest = builder.load(builder.gep(spec, [zero, ir.Constant(_I32, 1)]))
        return builder.add(builder.mul(seconds, ir.Constant(_I64, SECOND_NS)), rest)

    def _system_call(name: str, result: Any, widths: tuple[Any, ...], text: str) -> Any:
        """Return an intrinsic that takes int64 arguments and calls the symbol `name` with integers of these
        widths.
        """

        def codegen(context: Any, builder: Any, signature: Any, args: Any) -> Any:
            operands = [a if w == _I64 else builder.trunc(a, w) for a, w in zip(args, widths, strict=True)]
            return _call(builder, name, result, operands)

        int64 = types.int64
        if len(widths) == 3:

            def typing(typingctx: Any, a: Any, b: Any, c: Any) -> Any:
                return int64(int64, int64, int64), codegen
        else:

            def typing(typingctx: Any, a: Any, b: Any, c: Any, d: Any) -> Any:  # type: ignore[misc]
                return int64(int64, int64, int64, int64), codegen

        typing.__name__ = typing.__qualname__ = name
        typing.__doc__ = text
        return intrinsic(typing)

    @intrinsic  # type: ignore[untyped-decorator]
    def load_acquire(typingctx: Any, address: Any) -> Any:
        """Read the int64 at `address` with acquire order: earlier writes of its writer are visible, too."""

        def codegen(context: Any, builder: Any, signature: Any, args: Any) -> Any:
            return builder.load_atomic(builder.inttoptr(args[0], _I64.as_pointer()), "acquire", 8)

        return types.int64(types.int64), codegen

    @intrinsic  # type: ignore[untyped-decorator]
    def store_release(typingctx: Any, address: Any, value: Any) -> Any:
        """Write the int64 at `address` with release order: earlier writes become visible with it."""

        def codegen(context: Any, builder: Any, signature: Any, args: Any) -> Any:
            builder.store_atomic(args[1], builder.inttoptr(args[0], _I64.as_pointer()), "release", 8)
            return context.get_dummy_value()

        return types.void(types.int64, types.int64), codegen

    @intrinsic  # type: ignore[untyped-decorator]
    def errno(typingctx: Any) -> Any:
        """Return the calling thread's error number."""

        def codegen(context: Any, builder: Any, signature: Any, args: Any) -> Any:
            place = builder.inttoptr(_call(builder, "__errno_location", _I64, []), _I32.as_pointer())
            return builder.sext(builder.load(place), _I64)

        return types.int64(), codegen

    @intrinsic  # type: ignore[untyped-decorator]
    def getppid(typingctx: Any) -> Any:
        """Return the id of this process's parent; it changes when the parent ends."""

        def codegen(context: Any, builder: Any, signature: Any, args: Any) -> Any:
            return _call(builder, "getppid", _I32, [])

        return types.int64(), codegen

    @intrinsic  # type: ignore[untyped-decorator]
    def clock_ns(typingctx: Any, clock: Any) -> Any:
        """Return the time of the clock `clock` in ns."""

        def codegen(context: Any, builder: Any, signature: Any, args: Any) -> Any:
            return _clock(builder, builder.trunc(args[0], _I32))

        return types.int64(types.int64), codegen

    @intrinsic  # type: ignore[untyped-decorator]
    def now_ns(typingctx: Any) -> Any:
        """Return CLOCK_MONOTONIC in ns."""

        def codegen(context: Any, builder: Any, signature: Any, args: Any) -> Any:
            return _clock(builder, ir.Constant(_I32, CLOCK_MONOTONIC))

        return types.int64(), codegen

    @intrinsic  # type: ignore[untyped-decorator]
    def sleep_until(typingctx: Any, t_ns: Any) -> Any:
        """Sleep until CLOCK_MONOTONIC = `t_ns`.

        Return 0, or the error number (EINTR: interrupted by a signal).
        """

        def codegen(context: Any, builder: Any, signature: Any, args: Any) -> Any:
            clock, flags = ir.Constant(_I32, CLOCK_MONOTONIC), ir.Constant(_I32, TIMER_ABSTIME)
            return _call(builder, "clock_nanosleep", _I32, [clock, flags, _timespec(builder, args[0]), _NULL])

        return types.int64(types.int64), codegen

    @intrinsic  # type: ignore[untyped-decorator]
    def ppoll_ns(typingctx: Any, address: Any, count: Any, timeout_ns: Any) -> Any:
        """Wait for the `count` struct pollfd at `address`, at most `timeout_ns` (negative: for ever); return
        the number of ready descriptors.
        """

        def codegen(context: Any, builder: Any, signature: Any, args: Any) -> Any:
            forever = builder.icmp_signed("<", args[2], _NULL)
            spec = builder.select(forever, _NULL, _timespec(builder, args[2]))
            return _call(builder, "ppoll", _I32, [args[0], args[1], spec, _NULL])

        return types.int64(types.int64, types.int64, types.int64), codegen

    read = _system_call("read", _I64, (_I32, _I64, _I64), "read(2).")
    write = _system_call("write", _I64, (_I32, _I64, _I64), "write(2).")
    send = _system_call("send", _I64, (_I32, _I64, _I64, _I32), "send(2).")
    recv = _system_call("recv", _I64, (_I32, _I64, _I64, _I32), "recv(2).")
    recvmsg = _system_call("recvmsg", _I64, (_I32, _I64, _I32), "recvmsg(2) into the struct msghdr at an address.")
    epoll_wait = _system_call("epoll_wait", _I32, (_I32, _I64, _I32, _I32), "epoll_wait(2).")
    epoll_ctl = _system_call("epoll_ctl", _I32, (_I32, _I32, _I32, _I64), "epoll_ctl(2).")
