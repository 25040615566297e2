"""The paper is checked: compared systems, sweeps, tables and figures; textures from words."""
