"""From a bench series to a rubber: what its resistance and its force remember of strain, and how well that is known.

In: a table of time, strain, force and resistance of one specimen (`series`). Out: a `Rubber` (`law`), whose numbers
`fit` finds with their covariance; `rubber_file` keeps it as a design that others extend. `unknown` says what a series
does not tell, and which test would. Open `fit` first.
"""
