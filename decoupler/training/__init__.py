"""Training of a model on labelled samples.

`suited` completes what is asked for and looks at the samples, `trainer` trains, `network` is the network in torch,
`varpro`, `levenberg_marquardt` (both on `damping`) and `momentum` find its weights, and `error_bars` the errors to
expect.
"""
