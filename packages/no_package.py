"""Build backend of the top of the repository, which is no package: pip shows this line."""

import sys


def _refuse(*_: object, **__: object) -> None:
    sys.exit(
        "this repository holds three packages: pip install './packages/foten[serve]', and see README.md for the others"
    )


get_requires_for_build_wheel = get_requires_for_build_sdist = get_requires_for_build_editable = _refuse
build_wheel = build_sdist = build_editable = _refuse
