"""The perceptual study (Sec. VII): design, power, store, statistics, report. Its pages and server live in `studio`."""
