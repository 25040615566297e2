"""The tasks of a study, a file for each; `table.TASKS` lists them."""
