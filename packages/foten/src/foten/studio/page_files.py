"""Files of the page, for a server and for a folder that any host serves."""

from pathlib import Path

from foten.runtime.binding import kernel_file

PAGE = Path(__file__).with_name("page")
KERNEL = ("foten.mjs", "foten.wasm")


def page_files() -> dict[str, Path]:
    """Files of the page by name, the kernel's among them."""
    files = {path.name: path for path in PAGE.iterdir() if path.is_file()}
    return files | {name: kernel_file(name) for name in KERNEL}
