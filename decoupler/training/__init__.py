"""Training of a model on labelled samples.

`suited` looks at the samples and settles what is learned from them, `trainer` trains, and `error_bars` finds the errors
to expect. `one_layer` and `convolution` are networks; of the first, `weights` are what torch sees, which `varpro`,
`levenberg_marquardt` (both on `damping`) and `momentum` find. `finite_strain` learns maps of finite strain.
"""
