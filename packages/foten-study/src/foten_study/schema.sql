CREATE TABLE study (
    id INTEGER PRIMARY KEY CHECK (id = 1), title TEXT NOT NULL, design TEXT NOT NULL, folder TEXT NOT NULL, seed INTEGER NOT NULL,
    simulated INTEGER NOT NULL CHECK (simulated IN (0, 1)), created TEXT NOT NULL, software TEXT NOT NULL
) STRICT;
CREATE TABLE stimuli (
    texture INTEGER NOT NULL, method INTEGER NOT NULL, texture_key TEXT NOT NULL, method_key TEXT NOT NULL,
    sha256 TEXT NOT NULL, gain_db REAL NOT NULL, PRIMARY KEY (texture, method)
) STRICT;
CREATE TABLE trials (
    participant INTEGER NOT NULL, trial INTEGER NOT NULL, texture INTEGER NOT NULL, method INTEGER NOT NULL, other INTEGER,
    target INTEGER NOT NULL, PRIMARY KEY (participant, trial),
    FOREIGN KEY (texture, method) REFERENCES stimuli (texture, method),
    FOREIGN KEY (texture, other) REFERENCES stimuli (texture, method)
) STRICT;
CREATE TABLE participants (
    number INTEGER PRIMARY KEY, code TEXT NOT NULL UNIQUE, joined TEXT NOT NULL, simulated INTEGER NOT NULL
) STRICT;
CREATE TABLE consents (
    participant INTEGER PRIMARY KEY REFERENCES participants (number), at TEXT NOT NULL, text_sha256 TEXT NOT NULL
) STRICT;
CREATE TABLE abouts (
    participant INTEGER NOT NULL REFERENCES participants (number), question TEXT NOT NULL, answer TEXT NOT NULL, at TEXT NOT NULL,
    PRIMARY KEY (participant, question)
) STRICT;
CREATE TABLE answers (
    participant INTEGER NOT NULL REFERENCES participants (number), question TEXT NOT NULL, answer TEXT NOT NULL, at TEXT NOT NULL,
    PRIMARY KEY (participant, question)
) STRICT;
CREATE TABLE steps (
    participant INTEGER NOT NULL REFERENCES participants (number), step TEXT NOT NULL, at TEXT NOT NULL,
    PRIMARY KEY (participant, step)
) STRICT;
CREATE TABLE ratings (
    id INTEGER PRIMARY KEY, participant INTEGER NOT NULL REFERENCES participants (number), trial INTEGER NOT NULL,
    scale TEXT NOT NULL, rating REAL NOT NULL CHECK (rating BETWEEN 0 AND 100), response_s REAL,
    switches INTEGER, measured TEXT NOT NULL,
    at TEXT NOT NULL, software TEXT NOT NULL, simulated INTEGER NOT NULL, corrects INTEGER REFERENCES ratings (id),
    reason TEXT NOT NULL, FOREIGN KEY (participant, trial) REFERENCES trials (participant, trial)
) STRICT;
CREATE UNIQUE INDEX one_rating ON ratings (participant, trial, scale) WHERE corrects IS NULL;
CREATE UNIQUE INDEX one_correction ON ratings (corrects) WHERE corrects IS NOT NULL;
CREATE TABLE strokes (
    participant INTEGER NOT NULL REFERENCES participants (number), trial INTEGER NOT NULL, part INTEGER NOT NULL,
    interval INTEGER NOT NULL, at TEXT NOT NULL, events BLOB NOT NULL, conditions BLOB NOT NULL,
    PRIMARY KEY (participant, trial, part)
) STRICT;
CREATE TABLE switches (
    id INTEGER PRIMARY KEY, participant INTEGER NOT NULL REFERENCES participants (number), trial INTEGER NOT NULL,
    side TEXT NOT NULL, marked_by TEXT NOT NULL, at TEXT NOT NULL
) STRICT;
CREATE TABLE shown (
    participant INTEGER NOT NULL REFERENCES participants (number), trial INTEGER NOT NULL, at REAL NOT NULL,
    PRIMARY KEY (participant, trial)
) STRICT;
CREATE TABLE log (id INTEGER PRIMARY KEY, at TEXT NOT NULL, what TEXT NOT NULL) STRICT;
