* SPDX-License-Identifier: Apache-2.0
* A reference of its own with the outputs of 16 columns and the rows, and 10 pF of pin and board at r_ref: vref steps by
* 10 mV. Field: the outputs.
vstep step 0 pwl(0 0 10u 0 10.01u 0.01)
bvref vref_x agnd v=0.5+v(step)
rref_x r_ref_x agnd 50k
cref_x r_ref_x agnd 10p
xbank vref_x r_ref_x gate cp vdd vss bias
{outputs}
.save v(r_ref_x)
.tran 20n 60u
.meas tran before find v(r_ref_x) at=9u
.meas tran most max v(r_ref_x) from=10u to=60u
.meas tran after find v(r_ref_x) at=60u
