* SPDX-License-Identifier: Apache-2.0
* Supplies that come up in any order, or not at all: the current from the bias into a row driver and a test current.
* While they rise what counts is what goes through to agnd: gates that move take 0.3 mA a row for 10 ns as well.
* Fields, in seconds: the first ramp, the begin and end of the later one, step and stop; `ways`, one for each order.
vnow now 0 pwl(0 0 {ramp} 1)
vlater later 0 pwl(0 0 {late} 0 {end} 1)
vnever never 0 0
{ways}.options reltol=1e-4
.tran {step} {stop}
