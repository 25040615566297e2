"""`foten adapt`: measure on a page how a user feels her actuator."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from typer import Argument, Option

from foten.console import check_files, open_in_browser, say, say_code

if TYPE_CHECKING:
    from foten.editing.user import UserProfile
    from foten.studio.access import Access

MAX_CHANGE_DB = 0.01  # of the largest tones of an actuator, from one session to the next


def _resume_or_new(stored: UserProfile, now: UserProfile, output: Path) -> UserProfile:
    """The stored profile, or ValueError where it is another user's, or of another actuator."""
    if now.name and now.name != stored.name:
        raise ValueError(f"{output} is the profile of {stored.name or 'nobody'}, not of {now.name}: give another -o")
    if stored.unit != now.unit or any(
        abs(a - b) > MAX_CHANGE_DB for a, b in zip(stored.max_db, now.max_db, strict=True)
    ):
        was = f"with the actuator {stored.actuator}" if stored.actuator else "without an actuator profile"
        also = ", whose profile was different then" if stored.actuator == now.actuator else ""
        raise ValueError(f"{output} was measured {was}{also}: continue in the same way, or give another -o")
    return stored


def adapt(
    texture_file: Path | None = Argument(
        None, metavar="[T.foten]", help="Texture to match to its real surface, which lies beside the page."
    ),
    output: Path = Option(..., "-o", "--output", help="User profile to write (.json); an existing one is continued."),
    name: str = Option("", help="Name of the user, written into the cards of adapted textures."),
    feel: bool = Option(
        True, "--feel/--no-feel", help="Measure thresholds and equal strength at five frequencies (four minutes)."
    ),
    actuator: Path | None = Option(
        None, metavar="P.json", help="Profile of the actuator (.json), whose response is compensated."
    ),
    host: str = Option(
        "127.0.0.1",
        help="Address to listen on: 127.0.0.1 for this machine only, 0.0.0.0 for a tablet on the network, as in 'foten "
        "serve'.",
    ),
    port: int = Option(8000, min=0, max=65535, help="Port of the page; 0 chooses a free one."),
    open_page: bool = Option(True, "--open/--no-open", help="Open the page in this machine's browser."),
) -> None:
    """Measure on a page how a user feels her actuator: thresholds, equal strength, and the best match to a real surface.

    foten adapt denim.foten -o me.json: four minutes of tones, then up to 25 choices with the real denim beside the page.

    foten render denim.foten --user me.json …; foten serve --user me.json; foten edit denim.foten --user me.json -o mine.foten
    """
    from foten.editing.user import UserProfile, read_user
    from foten.models.texture_file import read_texture
    from foten.runtime.actuator import read_profile
    from foten.studio.web_server import serve as serve_page
    from foten_study.adapt_server import AdaptServer, largest_tones_db, reachable
    from foten_study.adapt_session import FULL_RANGES, Session

    if output.suffix != ".json":
        raise ValueError(f"a user's profile is written as .json, got -o {output.name}")
    if texture_file is None and not feel:
        raise ValueError("nothing to measure: give a texture file, or leave out --no-feel")
    check_files([output])
    profile = None if actuator is None else read_profile(actuator)
    known = "" if profile is None else profile.name or str(actuator)
    before = UserProfile(name, known, "full scale" if profile is None else "m/s²", largest_tones_db(profile))
    if output.exists():
        before = _resume_or_new(read_user(output), before, output)
    texture, ranges = None if texture_file is None else read_texture(texture_file), {}
    if texture is not None:
        if not texture.sizes.editable:
            raise ValueError(
                f"{texture_file} has the model {texture.card['model']}, expected foten-plus: others cannot be adjusted"
            )
        ranges = reachable(texture)
    title = "" if texture is None or texture_file is None else str(texture.card["texture"]) or texture_file.stem
    session = Session(before, title, ranges or FULL_RANGES, feel)
    if session.n_dropped:
        say(f"{session.n_dropped} earlier choices were made without the gains measured now: they are asked again")
    server = AdaptServer(session, output, texture, profile)

    def announce(access: Access, shown: str, joined: bool) -> None:
        link = access.link(shown)
        if session.answers and not joined:
            say(f"{output} holds {len(session.answers)} answers: the session continues after them")
        say(f"a device connected; link for another one: {link}" if joined else f"open {link}")
        if access.token is not None:
            say_code(link)
        elif open_page and not joined:
            open_in_browser(link)
        if not joined:
            say(f"answers are saved in {output}; Ctrl-C stops the server")

    serve_page(server.app, host, port, announce)
    for line in session.profile.in_words() if session.answers else ():
        print(line)
