* SPDX-License-Identifier: Apache-2.0
* A gate of 102 us takes the mean of the current: its square is the spectrum times sinc^2(f T), from a drift of a second
* up to 1 MHz, where sinc^2 is 1e-5. The sum runs over a fine logarithmic grid.
* Fields: the circuit and its source, the highest frequency, the share of the spectrum.
xline ibias vdd vss bias_line
{dut}
.control
noise v(out) {source} dec 100 1 {highest}
setplot noise1
let turn = 3.14159265 * frequency * 102u
let s = sin(turn) / turn
let power = onoise_spectrum^2 * ({share})
let rms = sqrt(vecmax(integ(power)))
print rms
quit
.endc
