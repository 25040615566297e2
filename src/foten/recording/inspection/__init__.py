"""What a recording holds and what is wrong with it, from its numbers alone; with pictures of both."""

from foten.recording.inspection.inspect import inspect_recording as inspect_recording
from foten.recording.inspection.pictures import write_pictures as write_pictures
