"""The law of rubber, and training without a design, judged on what others measured: ``python -m studies.real_rubber``.

In: clones of three repositories, none of whose files is kept here. Out: tables as JSON and Markdown, and a picture.
`strips`, `velostat` and `eflesh` read; `others` are methods beside ours; `judging` compares. Open `__main__` first.
"""
