"""From raw channels to scaled windows: recording, preprocess, trace, split, scaling, windows."""
