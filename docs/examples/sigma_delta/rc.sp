first-order sigma-delta: C holds the mean of input and feedback
vin vin 0 0.6283
rin vin x 100k
vd_dac d_dac 0 external
rdac d_dac x 100k
c1 x 0 1n
.options reltol=1e-6 abstol=1e-15 vntol=1e-9
