# Builds the kernel for another system with Zig's C compiler, which pip installs: 'pip install ziglang'.
#
#     cmake -S . -B build --toolchain native/zig.cmake -D FOTEN_TARGET=aarch64-linux-gnu.2.17
#
# The target is Zig's: processor, system, and the C library with the oldest version that is to do. FOTEN_ZIG is the compiler's path,
# where it is not in PATH.
set(FOTEN_ZIG zig CACHE STRING "path of Zig")
set(CMAKE_TRY_COMPILE_PLATFORM_VARIABLES FOTEN_TARGET FOTEN_ZIG)

string(REGEX MATCH "^[^-]+" CMAKE_SYSTEM_PROCESSOR "${FOTEN_TARGET}")
if(FOTEN_TARGET MATCHES "-linux-")
  set(CMAKE_SYSTEM_NAME Linux)
elseif(FOTEN_TARGET MATCHES "-macos")
  set(CMAKE_SYSTEM_NAME Darwin)
  # As the library is linked: it is not renamed when it is installed, which needs Apple's tool, asked for all the same.
  set(CMAKE_INSTALL_NAME_DIR "@rpath")
  set(CMAKE_BUILD_WITH_INSTALL_NAME_DIR ON)
  set(CMAKE_INSTALL_NAME_TOOL :)
elseif(FOTEN_TARGET MATCHES "-windows-")
  set(CMAKE_SYSTEM_NAME Windows)
else()
  message(FATAL_ERROR "FOTEN_TARGET is '${FOTEN_TARGET}', expected one of Zig's for Linux, macOS or Windows, as aarch64-linux-gnu.2.17")
endif()
set(CMAKE_C_COMPILER ${FOTEN_ZIG} cc -target ${FOTEN_TARGET})
# Zig adds checks for undefined behaviour and debugging information where it is not asked to leave them out.
set(CMAKE_C_FLAGS_INIT "-fno-sanitize=all -g0")
set(CMAKE_SHARED_LINKER_FLAGS_INIT "-s")
