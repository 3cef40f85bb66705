* SPDX-License-Identifier: Apache-2.0
* An analysis of supply_rejection.sp, in codes a millivolt: at most at any frequency, at most after the mean of a gate, and
* with sign at 1 kHz. Field: the source.
alter @{source}[acmag] = 1
ac dec 20 1k 10meg
let turn = pi*real(frequency)*102u
let share = 1/(turn*(turn gt 1) + (turn le 1))
let out = 20.4e3*i(vout_one)
let packet = 10.2e3*i(vpacket_one)
let {source}_one = vecmax(mag(out + packet))
print {source}_one
let {source}_one_gate = vecmax(mag(out)*share + mag(packet))
print {source}_one_gate
let {source}_one_slow = real(out[0] + packet[0])
print {source}_one_slow
let out = 20.4e3*i(vout_all)
let packet = 10.2e3*i(vpacket_all)
let {source}_all = vecmax(mag(out + packet))
print {source}_all
let {source}_all_gate = vecmax(mag(out)*share + mag(packet))
print {source}_all_gate
let {source}_all_slow = real(out[0] + packet[0])
print {source}_all_slow
alter @{source}[acmag] = 0
