"""The command line: `app.py` names its commands, `door.py` makes a command of a job, `help.py` prints what they do."""
