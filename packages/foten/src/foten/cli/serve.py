"""`foten serve`: the studio."""

from __future__ import annotations

import shutil
from contextlib import ExitStack
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING

from typer import Argument, Option

from foten.atomic_write import reason
from foten.cli.render import user_with
from foten.cli.stroke_options import Actuator, Channel, Device, Gain, UserFile
from foten.console import open_in_browser, say, say_code
from foten.editing.user import UserProfile, adapted
from foten.models.texture_file import read_texture, write_texture
from foten.recording.recording import counted
from foten.runtime.actuator import read_profile
from foten.studio.players import OutputDevice
from foten.studio.shelf import PICTURES, SUFFIX, Shelf, texture_files

if TYPE_CHECKING:
    from foten.studio.access import Access


def serve(
    textures: list[Path] | None = Argument(
        None, metavar="[T.foten|DIR]…", help="Texture files or folders; by default the textures that come with foten."
    ),
    host: str = Option(
        "127.0.0.1",
        help="Address to listen on: 127.0.0.1 for this machine only, 0.0.0.0 for the network (HTTPS, a link for each "
        "device).",
    ),
    port: int = Option(8000, min=0, max=65535, help="Port of the page; 0 chooses a free one."),
    captures: Path = Option(
        Path("captures"), metavar="DIR", help="Folder of captured surfaces; created with the first capture."
    ),
    to: str = Option(
        "sound", help="Output of the server: sound, daq:Dev1/ao0, udp:HOST:PORT, osc:HOST:PORT, or null (no output)."
    ),
    actuator: Actuator = None,
    gain: Gain = None,
    device: Device = None,
    channel: Channel = None,
    user: UserFile = None,
    open_page: bool = Option(True, "--open/--no-open", help="Open the page in this machine's browser."),
) -> None:
    """Serve a page to stroke textures with a mouse, a finger or a pen, and to capture your own surfaces. Ctrl-C stops it.

    foten serve

    foten serve denim.foten mesh.foten --host 0.0.0.0: for a tablet on the same network, by the link or code that is printed.

    foten serve --to daq:Dev1/ao0 --actuator coil.json: with a voice coil on an NI-DAQ of this machine.
    """
    from foten.studio.studio_server import Studio
    from foten.studio.web_server import serve as serve_studio

    output = OutputDevice(to, None if actuator is None else read_profile(actuator), gain, device, channel)
    if output != OutputDevice():
        output.check()
    folder = ExitStack()
    if user is not None:
        place = Path(folder.enter_context(TemporaryDirectory(prefix="foten-")))
        textures = _for_user(textures or [], user_with(user, actuator), place)
    shelf = Shelf(textures or [])
    for captured in sorted(captures.glob(f"*/*{SUFFIX}")):
        try:
            shelf.put(captured)
        except (OSError, ValueError) as error:  # one bad capture is no reason not to start
            why = reason(error).removeprefix(f"{captured}: ").removeprefix(f"{captured.name}: ")
            say(f"left out {captured}: {' '.join(why.split())}")
    studio = Studio(shelf, captures, output)

    def announce(access: Access, shown: str, joined: bool) -> None:
        link = access.link(shown)
        if joined:
            say(f"a device connected; link for the next one: {link}")
            say_code(link)
            return
        many = counted(studio.shelf.n_names, "texture")
        say(f"{many} at {link}")
        if access.token is not None:
            say_code(link)
            say("the link admits one device; once it is used, the next link is printed")
            say("the tablet warns once, because this server makes its own (self-signed) certificate at each start")
        say("Ctrl-C stops the server")
        if open_page and access.token is None:
            open_in_browser(link)

    with folder:
        serve_studio(studio.app, host, port, announce)


def _for_user(paths: list[Path], profile: UserProfile, folder: Path) -> list[Path]:
    """Textures as a user's profile has them, as files in a folder, with their pictures."""
    written = []
    for n, path in enumerate(texture_files(paths)):
        place = folder / str(n)  # files of one name stay apart
        place.mkdir()
        texture = read_texture(path)
        try:
            texture = adapted(texture, profile)
            say(f"{path.name}: adapted to {profile.name or 'the user'}")
        except ValueError as error:
            say(f"{path.name}: not adapted: {error}")
        written.append(place / path.name)
        write_texture(texture, written[-1])
        for picture in (path.with_suffix(suffix) for suffix in PICTURES):
            if picture.is_file():
                shutil.copy(picture, place)
    return written
