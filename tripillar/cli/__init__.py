"""The command line: `app.py` names its commands, `door.py` makes a command of a job, `plain.py` reads what is typed
plainly, `parser.py` all else, `help.py` prints what they do.
"""
