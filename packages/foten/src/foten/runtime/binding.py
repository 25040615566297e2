"""The kernel's C interface in ctypes: structures, signatures, and the library itself. See `native/include/foten.h`."""

import ctypes
from ctypes import POINTER, Structure, c_char_p, c_double, c_float, c_int, c_size_t, c_uint64, c_void_p
from functools import cache
from pathlib import Path

ABI = 7  # FOTEN_ABI of the header that this follows
NO_MEMORY, NO_PREDICTOR = 3, 5


class Info(Structure):
    _fields_ = [
        ("model", c_char_p),
        ("texture", c_char_p),
        ("rate_hz", c_double),
        ("window", c_int),
        ("has_excitation", c_int),
        ("trained_speed", c_double * 2),
        ("trained_force", c_double * 2),
        ("acceleration_sd", c_double),
        ("lowpass_hz", c_double),
        ("state_bytes", c_size_t),
        ("asks_predictor", c_int),
    ]


class _Counts(Structure):
    """Counts, shown by name."""

    def by_name(self) -> dict[str, int]:
        return {name: int(getattr(self, name)) for name, *_ in self._fields_}

    def __repr__(self) -> str:
        counts = ", ".join(f"{name}={value}" for name, value in self.by_name().items())
        return f"{type(self).__name__.removeprefix('Native')}({counts})"


class NativeStatistics(_Counts):
    """Counts of a state: foten_stats."""

    _outside = "n_speed_beyond n_force_beyond n_speed_clamped n_force_clamped n_below"
    _fields_ = [(name, c_uint64) for name in f"n {_outside} n_saturated n_refused n_limited n_lost".split()]


class NativeStylusStatistics(_Counts):
    """Counts of a stylus: foten_stylus_stats."""

    _fields_ = [(name, c_uint64) for name in ("n", "n_refused", "n_late", "n_dropped", "n_clipped", "n_jumps")]


class NativeActuator(Structure):
    """An actuator's figures: foten_actuator."""

    _fields_ = [(name, c_double) for name in ("resonance_hz", "damping", "gain", "lowest_hz", "limit")]


class StylusOptions(Structure):
    _fields_ = [("newtons", c_double), ("steepness", c_double)]


class Options(Structure):
    _fields_ = [
        ("rate_hz", c_double),
        ("seed", c_uint64),
        ("stream", c_uint64),
        ("deterministic", c_int),
        ("smooth", c_int),
    ]


LIBRARIES = ("libfoten.so", "libfoten.dylib", "libfoten.dll")
_FLOATS = _DOUBLES = c_void_p  # arrays, given as `array.ctypes`
PREDICTOR = ctypes.CFUNCTYPE(c_float, c_void_p, POINTER(c_float))
PREDICTOR_INPUTS = 4  # FOTEN_PREDICTOR_INPUTS: acceleration, speed, force and noise of a sample
_SIGNATURES = {
    "foten_abi": (c_int, []),
    "foten_version": (c_char_p, []),
    "foten_isa": (c_char_p, []),
    "foten_model_load": (c_int, [c_void_p, c_size_t, POINTER(c_void_p), c_char_p, c_size_t]),
    "foten_model_load_with": (c_int, [c_void_p, c_size_t, PREDICTOR, c_void_p, POINTER(c_void_p), c_char_p, c_size_t]),
    "foten_model_free": (None, [c_void_p]),
    "foten_model_info": (Info, [c_void_p]),
    "foten_state_new": (c_void_p, [c_void_p, POINTER(Options)]),
    "foten_state_free": (None, [c_void_p]),
    "foten_reset": (None, [c_void_p, c_uint64]),
    "foten_start": (c_int, [c_void_p, _FLOATS, _FLOATS, _FLOATS]),
    "foten_exclude_recorded": (None, [c_void_p, c_int, c_int]),
    "foten_start_scaled": (c_int, [c_void_p, _DOUBLES]),
    "foten_run_scaled": (None, [c_void_p, _DOUBLES, _DOUBLES, c_double, c_size_t, _DOUBLES]),
    "foten_predict": (c_int, [c_void_p, _DOUBLES, c_size_t, c_int, _DOUBLES]),
    "foten_set_condition": (None, [c_void_p, c_float, c_float]),
    "foten_render": (None, [c_void_p, _FLOATS, c_size_t]),
    "foten_render_stroke": (c_size_t, [c_void_p, _FLOATS, _FLOATS, c_size_t, _FLOATS]),
    "foten_rendered": (c_size_t, [c_void_p, c_size_t]),
    "foten_delay_s": (c_double, [c_void_p]),
    "foten_condition": (None, [c_void_p, POINTER(c_float), POINTER(c_float)]),
    "foten_statistics": (NativeStatistics, [c_void_p]),
    "foten_stylus_new": (c_void_p, [c_void_p, POINTER(StylusOptions)]),
    "foten_stylus_free": (None, [c_void_p]),
    "foten_stylus_push": (None, [c_void_p, c_double, c_double, c_double, c_double]),
    "foten_stylus_next": (None, [c_void_p, _FLOATS, _FLOATS]),
    "foten_render_stylus": (None, [c_void_p, c_void_p, _FLOATS, c_size_t]),
    "foten_stylus_statistics": (NativeStylusStatistics, [c_void_p]),
    "foten_set_actuator": (c_int, [c_void_p, POINTER(NativeActuator)]),
    "foten_noise": (None, [c_uint64, c_uint64, c_uint64, c_size_t, _DOUBLES]),
}


@cache
def library() -> ctypes.CDLL:
    """Library that was built with this package, or OSError where there is none that loads."""
    path = kernel_file(*LIBRARIES)
    kernel = ctypes.CDLL(str(path))
    if not hasattr(kernel, "foten_abi") or kernel.foten_abi() != ABI:
        another = f"{path.name} is of another version than this package"
        raise OSError(f"{another}: reinstall with 'pip install --force-reinstall .'")
    for name, (result, arguments) in _SIGNATURES.items():
        function = getattr(kernel, name)
        function.restype, function.argtypes = result, arguments
    return kernel


def kernel_file(*names: str) -> Path:
    """Path of the first of some files that lies in a kernel folder of the package."""
    # An editable install has the library in another folder than the sources: the package's path has both.
    import foten.runtime

    for name in names:
        for folder in foten.runtime.__path__:
            if (path := Path(folder, "kernel", name)).exists():
                return path
    missing = f"foten's kernel is not installed beside the package, there is no {names[0]}"
    raise OSError(f"{missing}: reinstall with 'pip install .', which builds it with a C compiler")


def c_flags() -> str:
    """Options of a C compiler for a program with the installed library, or OSError where there is none."""
    header, library = kernel_file("foten.h").parent, kernel_file(*LIBRARIES).parent
    return f"-I{header} -L{library} -Wl,-rpath,{library} -lfoten -lm"


def isa() -> str:
    """Instruction set that the kernel uses here."""
    return str(library().foten_isa().decode())
