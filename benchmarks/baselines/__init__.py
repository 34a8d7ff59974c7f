"""Yardsticks: other ways to compute what the package does, most of them on a base of velocity `+w` or `-w`.

Those are dimensionless (`z`, `u`, `omega t`; `rate` is `lambda / omega`) and keyword-only except for `program`.

- `c_yardstick`: vectorised C, `program` is `"events"` or `"intervals"`.
  `simulate(program, *, w, rate, t1, samples, y0=(0.0, 0.0), seed=0, initial_sign=0, threads=1, chain=0)`
  `-> Totals`
  `given_gaps(program, *, w, t1, gaps, y0=(0.0, 0.0), initial_sign=1) -> GivenResult`
- `numba_scalar`: a plain scalar loop.
  `simulate(*, w, rate, t1, samples, y0=(0.0, 0.0), seed=0, initial_sign=0, threads=1) -> Totals`
  `given_gaps(*, w, t1, gaps, y0=(0.0, 0.0), initial_sign=1) -> GivenResult`
- `scipy_events` and `diffrax_events`: a general ODE solver with event location, one trajectory.
  `simulate(*, gaps, velocities, t1, y0=(0.0, 0.0), tolerance=1e-8) -> Trajectory`
- `event_driver.switching_velocities(w, gaps, initial_sign=1)`: the `velocities` that go with given gaps.
- `numba_motor_cart`: the motor and cart (Lima and Sampaio 2022, SI units), a scalar Runge-Kutta loop of fixed step.
  `simulate(*, mu, t1, samples, seed=0, step=1e-4, threads=1) -> Sticks`
  `given(*, mu, t1, theta, alpha0, step=1e-4, threads=1) -> Sticks`
- `numba_two_blocks`: two coupled blocks on a belt, closed forms of each stick pattern.
  `given(x1, x2, *, t1, threads=1) -> Sticks`
- `numba_chain`: a chain of blocks on a belt, power series of all blocks, neighbours only.
  `given(x, *, t1, threads=1) -> Sticks`
- `scipy_harmonic`: a mass on a harmonic base by a general ODE solver with event location, once a period.
- `scipy_lugre`: a mass on bristles by an implicit ODE solver, one trajectory.
  `simulate(x, v, *, t1, method, tolerance) -> (position, velocity)`
- `scipy_chain`: a chain of blocks on a belt by a general ODE solver with event location, one trajectory.
  `simulate(x, *, t1, tolerance=1e-8) -> Sticks`

Result types: `_common`. The submodules are imported one by one, so that none needs the libraries of another.
"""
