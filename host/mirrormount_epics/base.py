"""Record types in Python, on the EPICS base of the wheel `epicscorelibs`, by ctypes: nothing is compiled.

    start_database()
    motors = RecordType("motor", definition, Handler)   # a Handler for each record: before(), put(), process()
    load(records)
    serve()

EPICS calls the handlers with the record locked, from its own threads; other threads use a record in `with record:`.

The structures of EPICS base that are read here are no part of its stable interface. So its version is pinned narrowly,
and check() compares what is read with what EPICS's own functions say: what differs refuses to run. The offsets of the
fields that every record has are copied from the record type `ai`; ours stand behind them.
"""

import contextlib
import ctypes as c
import logging
import math
import os
import sys
import tempfile
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, Protocol

from mirrormount.errors import EpicsFailed

# EPICS reads these when it starts to listen. Where the user has set one, it stays.
LOOPBACK = "127.0.0.1"
_LISTEN = ("EPICS_CAS_INTF_ADDR_LIST", "EPICS_PVAS_INTF_ADDR_LIST")
_BEACONS = ("EPICS_CAS_BEACON_ADDR_LIST", "EPICS_PVAS_BEACON_ADDR_LIST")
_AUTO_BEACONS = ("EPICS_CAS_AUTO_BEACON_ADDR_LIST", "EPICS_PVAS_AUTO_BEACON_ADDR_LIST")

VALUE, LOG = 1, 2  # who is told: monitors of values, archivers (caeventmask.h)
_kept: list[object] = []  # EPICS points into these until the process ends; a collected callback would crash it
_log = logging.getLogger("mirrormount.epics")


class Handler(Protocol):
    """What a record does. With the record locked."""

    def before(self, field: str) -> None:
        """A put of this field comes."""
        ...

    def put(self, field: str) -> bool:
        """It has been put. False: the put fails."""
        ...

    def process(self) -> None:
        """The record is processed."""
        ...


# ---- structures of EPICS base 7.0.10: dbStaticLib's dbBase.h, recSup.h, dbAddr.h

_Pointer = c.c_void_p


class _Node(c.Structure):
    _fields_ = [("next", _Pointer), ("previous", _Pointer)]


class _List(c.Structure):
    _fields_ = [("node", _Node), ("count", c.c_int)]


class _Field(c.Structure):
    _fields_ = [
        ("prompt", c.c_char_p),
        ("name", c.c_char_p),
        ("extra", c.c_char_p),
        ("record_type", _Pointer),
        ("index", c.c_short),
        ("special", c.c_short),
        ("type", c.c_int),
        ("bits", c.c_uint),
        ("base", c.c_int),
        ("group", c.c_short),
        ("interest", c.c_short),
        ("access_level", c.c_int),
        ("initial", c.c_char_p),
        ("private", _Pointer),
        ("size", c.c_short),
        ("offset", c.c_ushort),
    ]


class _Type(c.Structure):
    _fields_ = [
        ("node", _Node),
        ("attributes", _List),
        ("records", _List),
        ("devices", _List),
        ("definitions", _List),
        ("name", c.c_char_p),
        ("field_count", c.c_short),
        ("prompt_count", c.c_short),
        ("link_count", c.c_short),
        ("alias_count", c.c_short),
        ("link_indices", _Pointer),
        ("sorted_names", _Pointer),
        ("sorted_indices", _Pointer),
        ("value_field", _Pointer),
        ("value_index", c.c_short),
        ("fields", c.POINTER(c.POINTER(_Field))),
        ("support", _Pointer),
        ("record_size", c.c_int),
    ]


class _Entry(c.Structure):
    _fields_ = [("base", _Pointer), ("type", c.POINTER(_Type))]


class _Address(c.Structure):
    _fields_ = [("record", _Pointer), ("value", _Pointer), ("field", c.POINTER(_Field))]


_OfRecord = c.CFUNCTYPE(c.c_long, _Pointer)
_OfStage = c.CFUNCTYPE(c.c_long, _Pointer, c.c_int)
_OfField = c.CFUNCTYPE(c.c_long, c.POINTER(_Address), _Pointer)
_OfPut = c.CFUNCTYPE(c.c_long, c.POINTER(_Address), c.c_int)
_OfType = c.CFUNCTYPE(c.c_int, c.POINTER(_Type))


class _Notify(c.Structure):  # a put-callback (dbNotify.h)
    _fields_ = [
        ("restart", _Node),
        ("on_list", c.c_int),
        ("private", _Pointer),
        ("status", c.c_int),
        ("processed", c.c_int),
        ("request", c.c_int),
        ("channel", c.POINTER(_Pointer * 2)),  # its name, and the record
    ]


_NOTIFY_ERROR = 2


class _Support(c.Structure):
    _fields_ = [
        ("count", c.c_long),
        ("report", _Pointer),
        ("init", _Pointer),
        ("init_record", _OfStage),
        ("process", _OfRecord),
        ("special", _OfPut),
        ("get_value", _Pointer),
        ("conversions", _Pointer * 3),
        ("units", _OfField),
        ("precision", _OfField),
        ("enums", _Pointer * 3),
        ("graphic", _OfField),
        ("control", _OfField),
        ("alarms", _OfField),
    ]


_SUPPORT_COUNT = 17


class _Location(c.Structure):
    _fields_ = [("support", c.POINTER(_Support)), ("size", _OfType)]


_STRING, _DOUBLE = 0, 10  # numbers of field types (dbFldTypes.h)
_NUMBERS = {
    1: c.c_int8,
    2: c.c_uint8,
    3: c.c_int16,
    4: c.c_uint16,
    5: c.c_int32,
    6: c.c_uint32,
    9: c.c_float,
    _DOUBLE: c.c_double,
    11: c.c_uint16,
    12: c.c_uint16,
}
_LINKS = (14, 15, 16)
_NAME_SIZE = 61
_EPOCH_S = 631_152_000  # 1990, from which EPICS counts the seconds (epicsTime.h)

# ---- the database

_core: Any = None  # EPICS's libdbCore
_ioc: Any = None


def start_database() -> None:
    """Load EPICS base and its record types. Once in a process. Raises EpicsFailed."""
    global _core, _ioc
    from epicscorelibs import ioc

    _ioc, _core = ioc, ioc.dbCore
    for name in ("dbScanLock", "dbScanUnlock", "recGblFwdLink", "recGblGetTimeStamp", "recGblResetAlarms"):
        getattr(_core, name).argtypes = [_Pointer]
    _core.recGblResetAlarms.restype = c.c_ushort
    _core.recGblSetSevr.argtypes = [_Pointer, c.c_ushort, c.c_ushort]
    _core.db_post_events.argtypes = [_Pointer, _Pointer, c.c_uint]
    _core.dbAllocEntry.argtypes, _core.dbAllocEntry.restype = [_Pointer], c.POINTER(_Entry)
    _core.dbFindRecordType.argtypes = [c.POINTER(_Entry), c.c_char_p]
    _core.dbGetNFields.argtypes = _core.dbFirstField.argtypes = _core.dbNextField.argtypes = [
        c.POINTER(_Entry),
        c.c_int,
    ]
    _core.dbGetFieldName.argtypes, _core.dbGetFieldName.restype = [c.POINTER(_Entry)], c.c_char_p
    _core.dbGetFieldDbfType.argtypes = [c.POINTER(_Entry)]
    ioc.Com.epicsThreadGetNameSelf.restype = c.c_char_p
    ioc.Com.eltc(0)  # what EPICS prints while it starts is of no use to a person
    ioc.iocshRegisterCommon()
    _must("base.dbd", _core.dbLoadDatabase(b"base.dbd", ioc.DEFAULT_DBD_PATH.encode(), None))
    _must("its record types", ioc.registerRecordDeviceDriver(ioc.pdbbase))
    check()


def check() -> None:
    """Compare what is read from EPICS's structures with what its functions say. Raises EpicsFailed."""
    for name in (b"ai", b"mbbi", b"stringin"):
        entry = _core.dbAllocEntry(_ioc.pdbbase)
        _must(f"the record type {name!r}", _core.dbFindRecordType(entry, name))
        kind = entry.contents.type.contents
        if (kind.name, kind.field_count) != (name, _core.dbGetNFields(entry, 0)):
            raise _unknown(f"record type {name!r} is {kind.name!r}")
        end, status = 0, _core.dbFirstField(entry, 0)
        for i in range(kind.field_count):
            field = kind.fields[i].contents
            said = _core.dbGetFieldName(entry), _core.dbGetFieldDbfType(entry)
            size = c.sizeof(_NUMBERS[field.type]) if field.type in _NUMBERS else field.size
            if status or (field.name, field.type) != said or field.size != size or field.offset < end:
                raise _unknown(f"field {said[0]!r} of {name!r}")
            end = field.offset + field.size
            status = _core.dbNextField(entry, 0)
        first = kind.fields[0].contents
        if (first.name, first.offset, first.size) != (b"NAME", 0, _NAME_SIZE) or not end <= kind.record_size < end + 64:
            raise _unknown(f"the size of {name!r}")


def _unknown(what: str) -> EpicsFailed:
    return EpicsFailed(f"EPICS base has another structure than this program knows ({what}): nothing was started")


def _must(what: str, status: int) -> None:
    if status:
        raise EpicsFailed(f"EPICS base does not take {what} (status {status:#x})")


def load(records: str) -> None:
    """Load records, in the form of a .db file. Raises EpicsFailed."""
    with _as_file(records, ".db") as name:
        _must("the records", _core.dbLoadRecords(name, b""))


@contextlib.contextmanager
def _as_file(text: str, suffix: str) -> Iterator[bytes]:
    with tempfile.TemporaryDirectory(prefix="mirrormount-") as folder:
        path = Path(folder, f"records{suffix}")
        path.write_text(text, encoding="utf-8")
        yield os.fsencode(path)


def serve(host: str = LOOPBACK, rules: str | None = None, *, pva: bool = True) -> None:
    """Begin to serve Channel Access and PVAccess on one address of this computer.

    rules: access security, as in a file. pva: False: without PVAccess. Raises EpicsFailed.
    """
    for name in _LISTEN:
        os.environ.setdefault(name, host)
    if host == LOOPBACK:
        for beacons, automatic in zip(_BEACONS, _AUTO_BEACONS, strict=True):
            os.environ[beacons], os.environ[automatic] = LOOPBACK, "NO"
    # Run by root, EPICS would lock the stacks of all threads in memory: 325 MB instead of 65.
    c.c_int.in_dll(_core, "dbThreadRealtimeLock").value = 0
    if pva:
        _load_pvaccess()
    with _as_file(rules or "", ".acf") as name:
        if rules is not None:
            _must("the rules of access", _core.asSetFilename(name))
        with _no_banner():
            status = _core.iocInit()
        _must("its start (is the file of --acf right?)", status)
    _ioc.Com.errlogFlush()
    _ioc.Com.eltc(1)


def _load_pvaccess() -> None:
    from setuptools_dso import find_dso

    for library in ("epicscorelibs.lib.pvAccessIOC", "epicscorelibs.lib.qsrv"):
        c.CDLL(find_dso(library), c.RTLD_GLOBAL)
    for definitions in (b"PVAServerRegister.dbd", b"qsrv.dbd"):
        _must("PVAccess", _core.dbLoadDatabase(definitions, _ioc.DEFAULT_DBD_PATH.encode(), None))
    _must("PVAccess", _ioc.registerRecordDeviceDriver(_ioc.pdbbase))


@contextlib.contextmanager
def _no_banner() -> Iterator[None]:
    """Standard output is this program's; EPICS prints its version there."""
    sys.stdout.flush()
    out, nothing = os.dup(1), os.open(os.devnull, os.O_WRONLY)
    os.dup2(nothing, 1)
    try:
        yield
    finally:
        if os.name == "posix":
            c.CDLL(None).fflush(None)  # what C has not written yet
        os.dup2(out, 1)
        os.close(out)
        os.close(nothing)


def leave(status: int) -> None:
    """End the process: EPICS's threads would call into a Python that ends otherwise."""
    sys.stdout.flush()
    sys.stderr.flush()
    os._exit(status)


# ---- a record


class Record:
    """A record's fields by name. `with record:` locks it, and the time of what is told is then now."""

    def __init__(self, kind: "RecordType", address: int) -> None:
        self.name = c.string_at(address, _NAME_SIZE).split(b"\0")[0].decode()
        self._kind = kind
        self._address = address
        self._cells: dict[str, Any] = {}
        self._before: Any = None  # the value of the field that is being put
        self.refused = False  # a put was, and its put-callback is to be told

    def __getitem__(self, field: str) -> Any:
        value = self._cell(field).value
        return value.decode(errors="replace") if isinstance(value, bytes) else value

    def __setitem__(self, field: str, value: Any) -> None:
        cell = self._cell(field)
        cell.value = _cut(value, c.sizeof(cell) - 1) if isinstance(value, str) else value

    def update(self, **values: Any) -> None:
        """Set fields, and tell those that have changed."""
        for field, value in values.items():
            before = self[field]
            self[field] = value
            if self[field] != before:
                self.post(field)

    def post(self, field: str, mask: int = VALUE | LOG) -> None:
        """Tell a field."""
        _core.db_post_events(self._address, self._address + self._kind.layout[field][1], mask)

    def settle(self, status: int, severity: int) -> None:
        """The alarm is this. Who monitors a motor's fields is told with them."""
        self["UDF"] = 0
        self.stamp()
        if severity:
            _core.recGblSetSevr(self._address, status, severity)
        changed = _core.recGblResetAlarms(self._address)
        if changed:
            for field in ("VAL", "RBV", "DRBV", "DMOV"):
                if field in self._kind.layout:
                    self.post(field, changed)

    def done(self) -> None:
        """What was ordered is over: forward links are processed, put-callbacks return."""
        _core.recGblFwdLink(self._address)

    def stamp(self) -> None:
        """The time of what is told is now."""
        _core.recGblGetTimeStamp(self._address)

    def stamp_at(self, unix_s: float) -> None:
        """The time of what is told is this one, of a record whose .TSE is -2."""
        at_ns = max(0, round((unix_s - _EPOCH_S) * 1e9))
        offset = self._kind.layout["TIME"][1]
        for i, number in enumerate(divmod(at_ns, 10**9)):
            c.c_uint32.from_address(self._address + offset + 4 * i).value = number

    def fail_callback(self) -> None:
        """The put-callback that waits for this record, if one does, gets an error when the record is done."""
        at = _Pointer.from_address(self._address + self._kind.layout["PPN"][1]).value
        if at is not None:
            notify = _Notify.from_address(at)
            if notify.channel and notify.channel.contents[1] == self._address:
                notify.status = _NOTIFY_ERROR

    def blank(self, field: str) -> None:
        """A put comes: until it has been written, a number is one that nobody puts."""
        self._before = self[field]
        if not isinstance(self._before, str):
            self[field] = _nobodys(self._cell(field))

    def written(self, field: str) -> bool:
        """Has it been? EPICS base calls here also after a put that it could not convert, such as a word to a number."""
        value = self[field]
        if isinstance(value, str) or value != _nobodys(self._cell(field)):
            return True
        self[field] = self._before
        return False

    def __enter__(self) -> None:
        _core.dbScanLock(self._address)
        self.stamp()

    def __exit__(self, *_: object) -> None:
        _core.dbScanUnlock(self._address)

    def _cell(self, field: str) -> Any:
        if field not in self._cells:
            number, offset, size = self._kind.layout[field]
            kind = _NUMBERS.get(number) or (c.c_char * size)
            self._cells[field] = kind.from_address(self._address + offset)
        return self._cells[field]


def _nobodys(cell: Any) -> float:
    """The lowest number of this kind; the highest of those without sign."""
    if isinstance(cell, c.c_float | c.c_double):
        return -math.inf
    highest = type(cell)(-1).value
    return highest if highest > 0 else -(1 << 8 * c.sizeof(cell) - 1)


def _cut(text: str, size: int) -> bytes:
    return text.encode()[:size].decode(errors="ignore").encode()


class RecordType:
    """A record type whose records are handled by make(record). layout: type, offset and size of each field.

    definition: as in a .dbd file. Raises EpicsFailed.
    """

    def __init__(self, name: str, definition: str, make: Callable[[Record], Handler]) -> None:
        self.layout: dict[str, tuple[int, int, int]] = {}
        self._make = make
        self._handlers: dict[int, tuple[Record, Handler]] = {}
        with _as_file(definition, ".dbd") as file:
            _must(f"the record type {name}", _core.dbLoadDatabase(file, _ioc.DEFAULT_DBD_PATH.encode(), None))
        self._support = _Support(
            count=_SUPPORT_COUNT,
            init_record=_OfStage(self._init),
            process=_OfRecord(self._process),
            special=_OfPut(self._special),
            units=_OfField(self._units),
            precision=_OfField(self._precision),
            graphic=_OfField(self._graphic),
            control=_OfField(self._control),
            alarms=_OfField(_no_alarms),
        )
        self._location = _Location(c.pointer(self._support), _OfType(self._lay_out))
        self._names = (c.c_char_p * 1)(name.encode())
        _kept.append(self)
        _core.registerRecordTypes(_ioc.pdbbase, 1, self._names, c.byref(self._location))
        if not self.layout:
            raise _unknown(f"record type {name}")

    def _lay_out(self, kind: Any) -> int:
        """Give each field its place: those of every record where `ai` has them, ours behind."""
        entry = _core.dbAllocEntry(_ioc.pdbbase)
        if _core.dbFindRecordType(entry, b"ai"):
            return 1
        model, common, at, link = entry.contents.type.contents, {}, 0, 0
        for i in range(model.field_count):
            field = model.fields[i].contents
            if field.name == b"VAL":  # the first of ai's own
                at = field.offset
            if not at:
                common[field.name] = field.size, field.offset
            if field.name == b"INP":
                link = field.size
        for i in range(kind.contents.field_count):
            field = kind.contents.fields[i].contents
            if field.name in common:
                field.size, field.offset = common[field.name]
            else:
                if field.type in _NUMBERS:
                    field.size = c.sizeof(_NUMBERS[field.type])
                elif field.type in _LINKS:
                    field.size = link
                align = 1 if field.type == _STRING else 8
                field.offset = at = -(-at // align) * align
                at += field.size
            self.layout[field.name.decode()] = field.type, field.offset, field.size
        kind.contents.record_size = -(-at // 16) * 16
        return 0

    def _init(self, address: int, stage: int) -> int:
        with _told() as fault:
            if stage == 0:
                record = Record(self, address)
                self._handlers[address] = record, self._make(record)
        return int(bool(fault))

    def _process(self, address: int) -> int:
        with _told() as fault:
            record, handler = self._handlers[address]
            if record.refused:
                record.refused = False
                record.fail_callback()
            handler.process()
        return int(bool(fault))

    def _special(self, address: Any, after: int) -> int:
        with _told() as fault:
            record, handler = self._handlers[address.contents.record]
            field = address.contents.field.contents.name.decode()
            if after:
                if not record.written(field):  # EPICS base fails this put by itself
                    return 1
                record.refused = not handler.put(field)
                return int(record.refused and _may_fail())
            record.refused = False
            record.stamp()
            handler.before(field)
            record.blank(field)
        return int(bool(fault))

    def _units(self, address: Any, out: int) -> int:
        record = self._handlers[address.contents.record][0]
        if address.contents.field.contents.type == _DOUBLE and "EGU" in self.layout:
            text = record["EGU"].encode()[:15] + b"\0"
            c.memmove(out, text, len(text))
        return 0

    def _precision(self, address: Any, out: int) -> int:
        record = self._handlers[address.contents.record][0]
        c.c_long.from_address(out).value = record["PREC"] if "PREC" in self.layout else 0
        return 0

    def _graphic(self, address: Any, out: int) -> int:
        return self._range(address, out)

    def _control(self, address: Any, out: int) -> int:
        return self._range(address, out)

    def _range(self, address: Any, out: int) -> int:
        """The upper and the lower limit, of displays and of what can be put."""
        record = self._handlers[address.contents.record][0]
        dial = address.contents.field.contents.name in (b"DVAL", b"DRBV")
        names = ("DHLM", "DLLM") if dial else ("HLM", "LLM")
        high, low = (record[name] for name in names) if "HLM" in self.layout else (0.0, 0.0)
        c.c_double.from_address(out).value = high
        c.c_double.from_address(out + 8).value = low
        return 0


def _may_fail() -> bool:
    """May a put that is refused fail in this thread? In that of a client of Channel Access.

    EPICS base's server of PVAccess throws an exception through dbNotify.c then, if the client waits: the record and all
    put-callbacks stay locked for ever. So its client is told when the record is processed (fail_callback), or by the
    alarm.
    """
    return _ioc.Com.epicsThreadGetNameSelf().startswith(b"CAS-client")


def _no_alarms(_address: Any, out: int) -> int:
    for i in range(4):
        c.c_double.from_address(out + 8 * i).value = math.nan
    return 0


@contextlib.contextmanager
def _told() -> Iterator[list[Exception]]:
    """An exception must not go through EPICS: it is logged, and is in the list."""
    faults: list[Exception] = []
    try:
        yield faults
    except Exception as e:
        _log.exception("a record has a fault")
        faults.append(e)
