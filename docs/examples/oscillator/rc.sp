relaxation oscillator: q charges C through R between two thresholds
vd_q d_q 0 external
r1 d_q x 10k
c1 x 0 100p
.options reltol=1e-7 abstol=1e-15 vntol=1e-10 trtol=1 chgtol=1e-18
