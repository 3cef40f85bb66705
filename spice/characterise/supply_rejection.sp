* SPDX-License-Identifier: Apache-2.0
* What a millivolt on a supply or a reference moves a code by, from 1 kHz to 10 MHz: two columns at half a packet a clock,
* 1 mA from a taxel of 500 ohm, in one of them with 15 others pressed. A code is 510 currents of the column over that of a
* packet. On vss, board's ground moves against agnd, vref and vbias; a gate of 102 us takes the mean of the column's current,
* at 1 / (pi f 102 us) of its size, and packets are taken whole, since they may keep step with a ripple.
* Fields: the columns, the analyses.
vb vb 0 0.5
vrow logic_row 0 1
vcharge logic_charge 0 1
vhold logic_hold 0 1
vpreset logic_preset 0 0
vk0 logic_k0 0 0
vk1 logic_k1 0 1
{columns}
.control
{analyses}
quit
.endc
