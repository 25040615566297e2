"""What a recording holds and what is wrong with it, from its numbers alone."""

from foten.recording.inspection.inspect import inspect_recording as inspect_recording
