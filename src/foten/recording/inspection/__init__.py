"""What a recording holds and what is wrong with it, from its numbers alone; with pictures of both."""

from foten.recording.inspection.inspect import inspect_recording
from foten.recording.inspection.pictures import write_pictures
from foten.recording.inspection.values import NOTE, PROBLEM, ChannelReport, Coverage, Finding, Inspection

__all__ = [
    "NOTE",
    "PROBLEM",
    "ChannelReport",
    "Coverage",
    "Finding",
    "Inspection",
    "inspect_recording",
    "write_pictures",
]
