"""Looking at loaded sensors and scenes: `tripillar view`, its pictures, films and files for other viewers.

Open `command.py` first; `sights.py` says what is shown, `saving.py` how it becomes a file.
"""
