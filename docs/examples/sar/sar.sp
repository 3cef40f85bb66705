eight bits of charge redistribution: bottom plates go from the input to the bits
vin vin 0 pwl(0 0.1 1m 1.7)
vd_top d_top 0 external
vd_bottom d_bottom 0 external
.subckt plate d_bit top c=1p
bbottom bottom 0 v = v(d_bottom) * v(vin) + (1 - v(d_bottom)) * v(d_bit)
cplate bottom top {c}
.ends
.global d_bottom vin
vd_b7 d_b7 0 external
vd_b6 d_b6 0 external
vd_b5 d_b5 0 external
vd_b4 d_b4 0 external
vd_b3 d_b3 0 external
vd_b2 d_b2 0 external
vd_b1 d_b1 0 external
vd_b0 d_b0 0 external
x7 d_b7 top plate c=12.8p
x6 d_b6 top plate c=6.4p
x5 d_b5 top plate c=3.2p
x4 d_b4 top plate c=1.6p
x3 d_b3 top plate c=0.8p
x2 d_b2 top plate c=0.4p
x1 d_b1 top plate c=0.2p
x0 d_b0 top plate c=0.1p
xend 0 top plate c=0.1p
rtop top 0 1t
bswitch top 0 i = v(d_top) * v(top) * 1
.options reltol=1e-6 abstol=1e-15 vntol=1e-9 chgtol=1e-20
