"""A stand-in for the module ``gphoto2`` with a simulated Canon EOS 40D, after python-gphoto2 2.6 and libgphoto2 2.5.

The camera lives on a clock of its own: waiting for it costs no time. What it does wrong is scripted by its attributes.
"""

import types
from dataclasses import dataclass, field

MODEL = "Canon EOS 40D (PTP mode)"

CODES = {
    "GP_ERROR": (-1, "Unspecified error"),
    "GP_ERROR_BAD_PARAMETERS": (-2, "Bad parameters"),
    "GP_ERROR_UNKNOWN_PORT": (-5, "Unknown port"),
    "GP_ERROR_NOT_SUPPORTED": (-6, "Unsupported operation"),
    "GP_ERROR_IO": (-7, "I/O problem"),
    "GP_ERROR_TIMEOUT": (-10, "Timeout reading from or writing to the port"),
    "GP_ERROR_IO_INIT": (-31, "Error initializing the port"),
    "GP_ERROR_IO_READ": (-34, "Error reading from the port"),
    "GP_ERROR_IO_WRITE": (-35, "Error writing to the port"),
    "GP_ERROR_IO_UPDATE": (-37, "Error updating the port settings"),
    "GP_ERROR_IO_USB_CLEAR_HALT": (-51, "Error clearing a halt condition on the USB port"),
    "GP_ERROR_IO_USB_FIND": (-52, "Could not find the requested device on the USB port"),
    "GP_ERROR_IO_USB_CLAIM": (-53, "Could not claim the USB device"),
    "GP_ERROR_IO_LOCK": (-60, "Could not lock the device"),
    "GP_ERROR_MODEL_NOT_FOUND": (-105, "Unknown model"),
    "GP_ERROR_DIRECTORY_NOT_FOUND": (-107, "Directory not found"),
    "GP_ERROR_FILE_NOT_FOUND": (-108, "File not found"),
    "GP_ERROR_CAMERA_BUSY": (-110, "I/O in progress"),
    "GP_ERROR_CAMERA_ERROR": (-113, "Camera could not complete operation"),
    "GP_ERROR_NO_SPACE": (-115, "Not enough free space"),
}
CONSTANTS = {
    "GP_EVENT_UNKNOWN": 0,
    "GP_EVENT_TIMEOUT": 1,
    "GP_EVENT_FILE_ADDED": 2,
    "GP_EVENT_FOLDER_ADDED": 3,
    "GP_EVENT_CAPTURE_COMPLETE": 4,
    "GP_FILE_TYPE_NORMAL": 1,
    "GP_STORAGEINFO_FREESPACEKBYTES": 128,
    "GP_STORAGEINFO_FREESPACEIMAGES": 256,
}
_SECONDS = "30 25 20 15 13 10 8 6 5 4 3.2 2.5 2 1.6 1.3 1 0.8 0.6 0.5 0.4 0.3 1/4 1/5 1/6 1/8 1/10 1/13 1/15 1/20"
SHUTTER = _SECONDS.split()
SHUTTER += [f"1/{n}" for n in (25, 30, 40, 50, 60, 80, 100, 125, 160, 200, 250, 320, 400, 500, 640, 800, 1000)]
FORMATS = ["Large Fine JPEG", "Large Normal JPEG", "RAW", "RAW + Large Fine JPEG", "mRAW"]


class GPhoto2Error(Exception):
    def __init__(self, code):
        self.code = code
        self.string = dict(CODES.values()).get(code, "Unknown error")
        super().__init__(f"[{code}] {self.string}")


def fault(name: str) -> GPhoto2Error:
    return GPhoto2Error(CODES[name][0])


@dataclass
class Clock:
    time_s: float = 0.0
    slept_s: list = field(default_factory=list)

    def now(self) -> float:
        return self.time_s

    def sleep(self, seconds: float) -> None:
        self.slept_s.append(seconds)
        self.time_s += seconds


@dataclass
class Bench:
    """What is plugged in, and the state of the camera; ``script`` maps a call to faults that it raises in turn."""

    clock: Clock = field(default_factory=Clock)
    seen: list = field(default_factory=lambda: [(MODEL, "usb:001,004")])
    values: dict = field(default_factory=dict)
    choices: dict = field(default_factory=dict)
    readonly: set = field(default_factory=set)
    script: dict = field(default_factory=dict)
    #: Set after each shutter release: list of (seconds after it, file name, content or what makes it).
    delivers: list = field(default_factory=list)
    lag_reads: int = 0
    stubborn: dict = field(default_factory=dict)
    stores: list = field(default_factory=list)

    #: Number of the last time that the cable was pulled: a camera that was opened before is on a dead line.
    unplugged: int = 0
    #: Why the shutter is not released although the line is up; libgphoto2 says -1 and no more.
    refuses: bool = False

    calls: list = field(default_factory=list)
    opened: int = 0
    held: int = 0
    releases: list = field(default_factory=list)
    coming: list = field(default_factory=list)
    files: dict = field(default_factory=dict)
    _old: dict = field(default_factory=dict)

    def __post_init__(self):
        self.values = {
            "iso": "400", "aperture": "5.6", "shutterspeed": "1/125", "whitebalance": "Auto",
            "imageformat": "Large Fine JPEG", "capturetarget": "Memory card", "autopoweroff": "60",
            "batterylevel": "75%", "lensname": "EF50mm f/1.8 II", "serialnumber": "0",
            "eosserialnumber": "1234567890", "cameramodel": "Canon EOS 40D",
        } | self.values  # fmt: skip
        self.choices = {
            "iso": ["Auto", "100", "200", "400", "800", "1600"],
            "aperture": ["1.8", "2", "2.8", "4", "5.6", "8", "11", "16", "22"],
            "shutterspeed": ["bulb", *SHUTTER],
            "whitebalance": ["Auto", "Daylight", "Shadow", "Cloudy", "Tungsten", "Fluorescent", "Flash", "Manual"],
            "imageformat": FORMATS,
            "capturetarget": ["Internal RAM", "Memory card"],
        } | self.choices  # fmt: skip
        self.readonly |= {"batterylevel", "lensname", "serialnumber", "eosserialnumber", "cameramodel"}

    def unplug(self) -> None:
        """Pull the cable: nothing is on the bus, and a line that was open is dead for good."""
        self.unplugged += 1
        self.seen, self.coming, self.held = [], [], 0

    def plug(self, port: str = "usb:001,009") -> None:
        """Put the cable back."""
        self.seen = [(MODEL, port)]

    def call(self, name: str, camera=None) -> None:
        """Note a call, and raise what the script holds for it.

        On a dead line libgphoto2's PTP driver says -2 for one setting, -1 for waiting and for the rest, and still
        hands out the whole tree of settings, as observed on its own virtual camera.
        """
        self.calls.append(name)
        if camera is not None and not camera.is_open:
            raise AssertionError(f"{name} on a camera that is not open")
        if waiting := self.script.get(name):
            error = waiting.pop(0)
            if isinstance(error, BaseException):
                raise error
            if error is not None:
                error()
        if camera is not None and camera.since < self.unplugged and name != "get_config":
            raise fault("GP_ERROR_BAD_PARAMETERS" if name.endswith("single_config") else "GP_ERROR")

    def shown(self, name: str) -> str:
        if name in self._old:
            reads, old = self._old[name]
            if reads > 0:
                self._old[name] = (reads - 1, old)
                return old
        return self.values[name]

    def take(self, name: str, value: str) -> None:
        value = self.stubborn.get(name, value)
        self._old[name] = (self.lag_reads, self.values[name])
        self.values[name] = value

    def release(self) -> None:
        self.releases.append(dict(self.values))
        number = len(self.releases)
        # The files are numbered by the camera; {} in a scripted name is the number of the release.
        for delay, name, content in self.delivers:
            content = content() if callable(content) else content
            self.coming.append((self.clock.time_s + delay, name.format(f"{number:04d}"), content))
        self.coming.sort()


@dataclass
class CameraFilePath:
    folder: str
    name: str


@dataclass
class CameraStorageInformation:
    fields: int
    basedir: str
    freekbytes: int
    freeimages: int


class CameraFile:
    def __init__(self, data: bytes):
        self._data = data

    def get_data_and_size(self):
        return memoryview(self._data)

    def save(self, filename):
        with open(filename, "wb") as out:
            out.write(self._data)


class CameraWidget:
    def __init__(self, name, value="", choices=(), readonly=False, children=()):
        self._name, self._value, self._choices = name, value, list(choices)
        self._readonly, self._children = readonly, list(children)

    def get_name(self):
        return self._name

    def get_value(self):
        return self._value

    def set_value(self, value):
        if not isinstance(value, str):
            raise TypeError("expected a string")
        self._value = value

    def get_choices(self):
        return iter(self._choices)

    def get_readonly(self):
        return int(self._readonly)

    def count_children(self):
        return len(self._children)

    def get_child(self, index):
        return self._children[index]


@dataclass
class CameraAbilities:
    model: str


class CameraList:
    def __init__(self, pairs):
        self._pairs = pairs

    def count(self):
        return len(self._pairs)

    def get_name(self, index):
        return self._pairs[index][0]

    def get_value(self, index):
        return self._pairs[index][1]


class CameraAbilitiesList:
    models = ("Canon EOS 350D (PTP mode)", "Canon EOS 40D (PTP mode)", "Canon EOS 5D", "Nikon DSC D750")

    def __init__(self):
        self._loaded = ()

    def load(self):
        self._loaded = self.models

    def count(self):
        return len(self._loaded)

    def lookup_model(self, model):
        if model not in self._loaded:
            raise fault("GP_ERROR_MODEL_NOT_FOUND")
        return self._loaded.index(model)

    def get_abilities(self, index):
        return CameraAbilities(self._loaded[index])


def make_module(bench: Bench) -> types.ModuleType:
    """Return a module ``gphoto2`` whose camera is that of the bench."""

    class PortInfoList:
        def load(self):
            self._ports = ["usb:"]

        def lookup_path(self, path):
            # Every address on the bus is a port, also where nothing stands there.
            if not path.startswith("usb:"):
                raise fault("GP_ERROR_UNKNOWN_PORT")
            self._ports.append(path)
            return len(self._ports) - 1

        def get_info(self, index):
            return self._ports[index]

    class Camera:
        def __init__(self):
            self.is_open, self._model, self._port = False, None, None

        @staticmethod
        def autodetect():
            bench.call("autodetect")
            return CameraList(list(bench.seen))

        def set_abilities(self, abilities):
            self._model = abilities.model

        def set_port_info(self, info):
            self._port = info

        def init(self):
            bench.call("init")
            if self._port not in [port for _, port in bench.seen]:
                raise fault("GP_ERROR_BAD_PARAMETERS")
            if (self._model, self._port) not in bench.seen:
                raise fault("GP_ERROR_MODEL_NOT_FOUND")
            if bench.held:
                raise fault("GP_ERROR_IO_USB_CLAIM")
            self.is_open, self.since = True, bench.unplugged
            bench.held += 1
            bench.opened += 1

        def exit(self):
            bench.calls.append("exit")
            if self.is_open:
                self.is_open = False
                bench.held -= self.since == bench.unplugged

        def _widget(self, name):
            return CameraWidget(name, bench.shown(name), bench.choices.get(name, ()), name in bench.readonly)

        def get_config(self):
            bench.call("get_config", self)
            section = CameraWidget("settings", children=[self._widget(name) for name in bench.values])
            return CameraWidget("main", children=[section])

        def get_single_config(self, name):
            bench.call("get_single_config", self)
            if name not in bench.values:
                raise fault("GP_ERROR_BAD_PARAMETERS")
            return self._widget(name)

        def set_single_config(self, name, widget):
            bench.call("set_single_config", self)
            value = widget.get_value()
            if name in bench.readonly or (name in bench.choices and value not in bench.choices[name]):
                raise fault("GP_ERROR_BAD_PARAMETERS")
            bench.take(name, value)

        def trigger_capture(self):
            bench.call("trigger_capture", self)
            if bench.refuses:
                raise fault("GP_ERROR")
            bench.release()

        def wait_for_event(self, timeout):
            assert isinstance(timeout, int) and timeout > 0
            bench.call("wait_for_event", self)
            limit = bench.clock.time_s + timeout / 1000.0
            if bench.coming and bench.coming[0][0] <= limit:
                time_s, name, content = bench.coming.pop(0)
                bench.clock.time_s = max(bench.clock.time_s, time_s)
                if name == "complete":
                    return CONSTANTS["GP_EVENT_CAPTURE_COMPLETE"], None
                if name == "unknown":
                    return CONSTANTS["GP_EVENT_UNKNOWN"], "PTP Property d1d3 changed"
                bench.files["/", name] = content
                return CONSTANTS["GP_EVENT_FILE_ADDED"], CameraFilePath("/", name)
            bench.clock.time_s = limit
            return CONSTANTS["GP_EVENT_TIMEOUT"], None

        def file_get(self, folder, file, type):
            bench.call("file_get", self)
            if (folder, file) not in bench.files:
                raise fault("GP_ERROR_FILE_NOT_FOUND")
            return CameraFile(bench.files[folder, file])

        def file_delete(self, folder, file):
            bench.call("file_delete", self)
            if bench.files.pop((folder, file), None) is None:
                raise fault("GP_ERROR_FILE_NOT_FOUND")

        def get_storageinfo(self):
            bench.call("get_storageinfo", self)
            return bench.stores

    module = types.ModuleType("gphoto2")
    vars(module).update({name: code for name, (code, _) in CODES.items()} | CONSTANTS)
    for thing in (
        GPhoto2Error, CameraFilePath, CameraFile, CameraWidget, CameraAbilities, CameraAbilitiesList, CameraList,
        CameraStorageInformation, PortInfoList, Camera,
    ):  # fmt: skip
        setattr(module, thing.__name__, thing)
    return module
