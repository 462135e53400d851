"""A trained model: ohms in, newtons and their half-widths out.

`decoder` is what every decoder keeps. A `decoupler` is a `front`, the feature of readings that it takes, and a
`network`, with what they know of loads (`usual`), of the sensor (`ensemble`) and of their own errors (`uncertainty`);
`at_strain` refines its answers at finite strain. `settings` say what is asked for, `baseline` holds the simplest
decouplers, `left_out` and `foretold` what stands for pillars that fail, and `tensors` the same computation in torch.
"""
