* SPDX-License-Identifier: Apache-2.0
* The 16 x 16 taxel array, each taxel r_r<row>c<col>_ohm. Generated from models/design.toml; change it there and run: dermis generate
* Take `array` to leave the lateral resistors out, `array_lateral` to have them (r_lateral_ohm).
.subckt array
+ r0 r1 r2 r3 r4 r5 r6 r7 r8 r9 r10 r11 r12 r13 r14 r15
+ c0 c1 c2 c3 c4 c5 c6 c7 c8 c9 c10 c11 c12 c13 c14 c15
+ params: r_r0c0_ohm=64250.0 r_r0c1_ohm=64250.0 r_r0c2_ohm=64250.0 r_r0c3_ohm=64250.0
+ r_r0c4_ohm=64250.0 r_r0c5_ohm=64250.0 r_r0c6_ohm=64250.0 r_r0c7_ohm=64250.0
+ r_r0c8_ohm=64250.0 r_r0c9_ohm=64250.0 r_r0c10_ohm=64250.0 r_r0c11_ohm=64250.0
+ r_r0c12_ohm=64250.0 r_r0c13_ohm=64250.0 r_r0c14_ohm=64250.0 r_r0c15_ohm=64250.0
+ r_r1c0_ohm=64250.0 r_r1c1_ohm=64250.0 r_r1c2_ohm=64250.0 r_r1c3_ohm=64250.0
+ r_r1c4_ohm=64250.0 r_r1c5_ohm=64250.0 r_r1c6_ohm=64250.0 r_r1c7_ohm=64250.0
+ r_r1c8_ohm=64250.0 r_r1c9_ohm=64250.0 r_r1c10_ohm=64250.0 r_r1c11_ohm=64250.0
+ r_r1c12_ohm=64250.0 r_r1c13_ohm=64250.0 r_r1c14_ohm=64250.0 r_r1c15_ohm=64250.0
+ r_r2c0_ohm=64250.0 r_r2c1_ohm=64250.0 r_r2c2_ohm=64250.0 r_r2c3_ohm=64250.0
+ r_r2c4_ohm=64250.0 r_r2c5_ohm=64250.0 r_r2c6_ohm=64250.0 r_r2c7_ohm=64250.0
+ r_r2c8_ohm=64250.0 r_r2c9_ohm=64250.0 r_r2c10_ohm=64250.0 r_r2c11_ohm=64250.0
+ r_r2c12_ohm=64250.0 r_r2c13_ohm=64250.0 r_r2c14_ohm=64250.0 r_r2c15_ohm=64250.0
+ r_r3c0_ohm=64250.0 r_r3c1_ohm=64250.0 r_r3c2_ohm=64250.0 r_r3c3_ohm=64250.0
+ r_r3c4_ohm=64250.0 r_r3c5_ohm=64250.0 r_r3c6_ohm=64250.0 r_r3c7_ohm=64250.0
+ r_r3c8_ohm=64250.0 r_r3c9_ohm=64250.0 r_r3c10_ohm=64250.0 r_r3c11_ohm=64250.0
+ r_r3c12_ohm=64250.0 r_r3c13_ohm=64250.0 r_r3c14_ohm=64250.0 r_r3c15_ohm=64250.0
+ r_r4c0_ohm=64250.0 r_r4c1_ohm=64250.0 r_r4c2_ohm=64250.0 r_r4c3_ohm=64250.0
+ r_r4c4_ohm=64250.0 r_r4c5_ohm=64250.0 r_r4c6_ohm=64250.0 r_r4c7_ohm=64250.0
+ r_r4c8_ohm=64250.0 r_r4c9_ohm=64250.0 r_r4c10_ohm=64250.0 r_r4c11_ohm=64250.0
+ r_r4c12_ohm=64250.0 r_r4c13_ohm=64250.0 r_r4c14_ohm=64250.0 r_r4c15_ohm=64250.0
+ r_r5c0_ohm=64250.0 r_r5c1_ohm=64250.0 r_r5c2_ohm=64250.0 r_r5c3_ohm=64250.0
+ r_r5c4_ohm=64250.0 r_r5c5_ohm=64250.0 r_r5c6_ohm=64250.0 r_r5c7_ohm=64250.0
+ r_r5c8_ohm=64250.0 r_r5c9_ohm=64250.0 r_r5c10_ohm=64250.0 r_r5c11_ohm=64250.0
+ r_r5c12_ohm=64250.0 r_r5c13_ohm=64250.0 r_r5c14_ohm=64250.0 r_r5c15_ohm=64250.0
+ r_r6c0_ohm=64250.0 r_r6c1_ohm=64250.0 r_r6c2_ohm=64250.0 r_r6c3_ohm=64250.0
+ r_r6c4_ohm=64250.0 r_r6c5_ohm=64250.0 r_r6c6_ohm=64250.0 r_r6c7_ohm=64250.0
+ r_r6c8_ohm=64250.0 r_r6c9_ohm=64250.0 r_r6c10_ohm=64250.0 r_r6c11_ohm=64250.0
+ r_r6c12_ohm=64250.0 r_r6c13_ohm=64250.0 r_r6c14_ohm=64250.0 r_r6c15_ohm=64250.0
+ r_r7c0_ohm=64250.0 r_r7c1_ohm=64250.0 r_r7c2_ohm=64250.0 r_r7c3_ohm=64250.0
+ r_r7c4_ohm=64250.0 r_r7c5_ohm=64250.0 r_r7c6_ohm=64250.0 r_r7c7_ohm=64250.0
+ r_r7c8_ohm=64250.0 r_r7c9_ohm=64250.0 r_r7c10_ohm=64250.0 r_r7c11_ohm=64250.0
+ r_r7c12_ohm=64250.0 r_r7c13_ohm=64250.0 r_r7c14_ohm=64250.0 r_r7c15_ohm=64250.0
+ r_r8c0_ohm=64250.0 r_r8c1_ohm=64250.0 r_r8c2_ohm=64250.0 r_r8c3_ohm=64250.0
+ r_r8c4_ohm=64250.0 r_r8c5_ohm=64250.0 r_r8c6_ohm=64250.0 r_r8c7_ohm=64250.0
+ r_r8c8_ohm=64250.0 r_r8c9_ohm=64250.0 r_r8c10_ohm=64250.0 r_r8c11_ohm=64250.0
+ r_r8c12_ohm=64250.0 r_r8c13_ohm=64250.0 r_r8c14_ohm=64250.0 r_r8c15_ohm=64250.0
+ r_r9c0_ohm=64250.0 r_r9c1_ohm=64250.0 r_r9c2_ohm=64250.0 r_r9c3_ohm=64250.0
+ r_r9c4_ohm=64250.0 r_r9c5_ohm=64250.0 r_r9c6_ohm=64250.0 r_r9c7_ohm=64250.0
+ r_r9c8_ohm=64250.0 r_r9c9_ohm=64250.0 r_r9c10_ohm=64250.0 r_r9c11_ohm=64250.0
+ r_r9c12_ohm=64250.0 r_r9c13_ohm=64250.0 r_r9c14_ohm=64250.0 r_r9c15_ohm=64250.0
+ r_r10c0_ohm=64250.0 r_r10c1_ohm=64250.0 r_r10c2_ohm=64250.0 r_r10c3_ohm=64250.0
+ r_r10c4_ohm=64250.0 r_r10c5_ohm=64250.0 r_r10c6_ohm=64250.0 r_r10c7_ohm=64250.0
+ r_r10c8_ohm=64250.0 r_r10c9_ohm=64250.0 r_r10c10_ohm=64250.0 r_r10c11_ohm=64250.0
+ r_r10c12_ohm=64250.0 r_r10c13_ohm=64250.0 r_r10c14_ohm=64250.0 r_r10c15_ohm=64250.0
+ r_r11c0_ohm=64250.0 r_r11c1_ohm=64250.0 r_r11c2_ohm=64250.0 r_r11c3_ohm=64250.0
+ r_r11c4_ohm=64250.0 r_r11c5_ohm=64250.0 r_r11c6_ohm=64250.0 r_r11c7_ohm=64250.0
+ r_r11c8_ohm=64250.0 r_r11c9_ohm=64250.0 r_r11c10_ohm=64250.0 r_r11c11_ohm=64250.0
+ r_r11c12_ohm=64250.0 r_r11c13_ohm=64250.0 r_r11c14_ohm=64250.0 r_r11c15_ohm=64250.0
+ r_r12c0_ohm=64250.0 r_r12c1_ohm=64250.0 r_r12c2_ohm=64250.0 r_r12c3_ohm=64250.0
+ r_r12c4_ohm=64250.0 r_r12c5_ohm=64250.0 r_r12c6_ohm=64250.0 r_r12c7_ohm=64250.0
+ r_r12c8_ohm=64250.0 r_r12c9_ohm=64250.0 r_r12c10_ohm=64250.0 r_r12c11_ohm=64250.0
+ r_r12c12_ohm=64250.0 r_r12c13_ohm=64250.0 r_r12c14_ohm=64250.0 r_r12c15_ohm=64250.0
+ r_r13c0_ohm=64250.0 r_r13c1_ohm=64250.0 r_r13c2_ohm=64250.0 r_r13c3_ohm=64250.0
+ r_r13c4_ohm=64250.0 r_r13c5_ohm=64250.0 r_r13c6_ohm=64250.0 r_r13c7_ohm=64250.0
+ r_r13c8_ohm=64250.0 r_r13c9_ohm=64250.0 r_r13c10_ohm=64250.0 r_r13c11_ohm=64250.0
+ r_r13c12_ohm=64250.0 r_r13c13_ohm=64250.0 r_r13c14_ohm=64250.0 r_r13c15_ohm=64250.0
+ r_r14c0_ohm=64250.0 r_r14c1_ohm=64250.0 r_r14c2_ohm=64250.0 r_r14c3_ohm=64250.0
+ r_r14c4_ohm=64250.0 r_r14c5_ohm=64250.0 r_r14c6_ohm=64250.0 r_r14c7_ohm=64250.0
+ r_r14c8_ohm=64250.0 r_r14c9_ohm=64250.0 r_r14c10_ohm=64250.0 r_r14c11_ohm=64250.0
+ r_r14c12_ohm=64250.0 r_r14c13_ohm=64250.0 r_r14c14_ohm=64250.0 r_r14c15_ohm=64250.0
+ r_r15c0_ohm=64250.0 r_r15c1_ohm=64250.0 r_r15c2_ohm=64250.0 r_r15c3_ohm=64250.0
+ r_r15c4_ohm=64250.0 r_r15c5_ohm=64250.0 r_r15c6_ohm=64250.0 r_r15c7_ohm=64250.0
+ r_r15c8_ohm=64250.0 r_r15c9_ohm=64250.0 r_r15c10_ohm=64250.0 r_r15c11_ohm=64250.0
+ r_r15c12_ohm=64250.0 r_r15c13_ohm=64250.0 r_r15c14_ohm=64250.0 r_r15c15_ohm=64250.0
rtaxel_r0c0 r0 c0 {r_r0c0_ohm}
rtaxel_r0c1 r0 c1 {r_r0c1_ohm}
rtaxel_r0c2 r0 c2 {r_r0c2_ohm}
rtaxel_r0c3 r0 c3 {r_r0c3_ohm}
rtaxel_r0c4 r0 c4 {r_r0c4_ohm}
rtaxel_r0c5 r0 c5 {r_r0c5_ohm}
rtaxel_r0c6 r0 c6 {r_r0c6_ohm}
rtaxel_r0c7 r0 c7 {r_r0c7_ohm}
rtaxel_r0c8 r0 c8 {r_r0c8_ohm}
rtaxel_r0c9 r0 c9 {r_r0c9_ohm}
rtaxel_r0c10 r0 c10 {r_r0c10_ohm}
rtaxel_r0c11 r0 c11 {r_r0c11_ohm}
rtaxel_r0c12 r0 c12 {r_r0c12_ohm}
rtaxel_r0c13 r0 c13 {r_r0c13_ohm}
rtaxel_r0c14 r0 c14 {r_r0c14_ohm}
rtaxel_r0c15 r0 c15 {r_r0c15_ohm}
rtaxel_r1c0 r1 c0 {r_r1c0_ohm}
rtaxel_r1c1 r1 c1 {r_r1c1_ohm}
rtaxel_r1c2 r1 c2 {r_r1c2_ohm}
rtaxel_r1c3 r1 c3 {r_r1c3_ohm}
rtaxel_r1c4 r1 c4 {r_r1c4_ohm}
rtaxel_r1c5 r1 c5 {r_r1c5_ohm}
rtaxel_r1c6 r1 c6 {r_r1c6_ohm}
rtaxel_r1c7 r1 c7 {r_r1c7_ohm}
rtaxel_r1c8 r1 c8 {r_r1c8_ohm}
rtaxel_r1c9 r1 c9 {r_r1c9_ohm}
rtaxel_r1c10 r1 c10 {r_r1c10_ohm}
rtaxel_r1c11 r1 c11 {r_r1c11_ohm}
rtaxel_r1c12 r1 c12 {r_r1c12_ohm}
rtaxel_r1c13 r1 c13 {r_r1c13_ohm}
rtaxel_r1c14 r1 c14 {r_r1c14_ohm}
rtaxel_r1c15 r1 c15 {r_r1c15_ohm}
rtaxel_r2c0 r2 c0 {r_r2c0_ohm}
rtaxel_r2c1 r2 c1 {r_r2c1_ohm}
rtaxel_r2c2 r2 c2 {r_r2c2_ohm}
rtaxel_r2c3 r2 c3 {r_r2c3_ohm}
rtaxel_r2c4 r2 c4 {r_r2c4_ohm}
rtaxel_r2c5 r2 c5 {r_r2c5_ohm}
rtaxel_r2c6 r2 c6 {r_r2c6_ohm}
rtaxel_r2c7 r2 c7 {r_r2c7_ohm}
rtaxel_r2c8 r2 c8 {r_r2c8_ohm}
rtaxel_r2c9 r2 c9 {r_r2c9_ohm}
rtaxel_r2c10 r2 c10 {r_r2c10_ohm}
rtaxel_r2c11 r2 c11 {r_r2c11_ohm}
rtaxel_r2c12 r2 c12 {r_r2c12_ohm}
rtaxel_r2c13 r2 c13 {r_r2c13_ohm}
rtaxel_r2c14 r2 c14 {r_r2c14_ohm}
rtaxel_r2c15 r2 c15 {r_r2c15_ohm}
rtaxel_r3c0 r3 c0 {r_r3c0_ohm}
rtaxel_r3c1 r3 c1 {r_r3c1_ohm}
rtaxel_r3c2 r3 c2 {r_r3c2_ohm}
rtaxel_r3c3 r3 c3 {r_r3c3_ohm}
rtaxel_r3c4 r3 c4 {r_r3c4_ohm}
rtaxel_r3c5 r3 c5 {r_r3c5_ohm}
rtaxel_r3c6 r3 c6 {r_r3c6_ohm}
rtaxel_r3c7 r3 c7 {r_r3c7_ohm}
rtaxel_r3c8 r3 c8 {r_r3c8_ohm}
rtaxel_r3c9 r3 c9 {r_r3c9_ohm}
rtaxel_r3c10 r3 c10 {r_r3c10_ohm}
rtaxel_r3c11 r3 c11 {r_r3c11_ohm}
rtaxel_r3c12 r3 c12 {r_r3c12_ohm}
rtaxel_r3c13 r3 c13 {r_r3c13_ohm}
rtaxel_r3c14 r3 c14 {r_r3c14_ohm}
rtaxel_r3c15 r3 c15 {r_r3c15_ohm}
rtaxel_r4c0 r4 c0 {r_r4c0_ohm}
rtaxel_r4c1 r4 c1 {r_r4c1_ohm}
rtaxel_r4c2 r4 c2 {r_r4c2_ohm}
rtaxel_r4c3 r4 c3 {r_r4c3_ohm}
rtaxel_r4c4 r4 c4 {r_r4c4_ohm}
rtaxel_r4c5 r4 c5 {r_r4c5_ohm}
rtaxel_r4c6 r4 c6 {r_r4c6_ohm}
rtaxel_r4c7 r4 c7 {r_r4c7_ohm}
rtaxel_r4c8 r4 c8 {r_r4c8_ohm}
rtaxel_r4c9 r4 c9 {r_r4c9_ohm}
rtaxel_r4c10 r4 c10 {r_r4c10_ohm}
rtaxel_r4c11 r4 c11 {r_r4c11_ohm}
rtaxel_r4c12 r4 c12 {r_r4c12_ohm}
rtaxel_r4c13 r4 c13 {r_r4c13_ohm}
rtaxel_r4c14 r4 c14 {r_r4c14_ohm}
rtaxel_r4c15 r4 c15 {r_r4c15_ohm}
rtaxel_r5c0 r5 c0 {r_r5c0_ohm}
rtaxel_r5c1 r5 c1 {r_r5c1_ohm}
rtaxel_r5c2 r5 c2 {r_r5c2_ohm}
rtaxel_r5c3 r5 c3 {r_r5c3_ohm}
rtaxel_r5c4 r5 c4 {r_r5c4_ohm}
rtaxel_r5c5 r5 c5 {r_r5c5_ohm}
rtaxel_r5c6 r5 c6 {r_r5c6_ohm}
rtaxel_r5c7 r5 c7 {r_r5c7_ohm}
rtaxel_r5c8 r5 c8 {r_r5c8_ohm}
rtaxel_r5c9 r5 c9 {r_r5c9_ohm}
rtaxel_r5c10 r5 c10 {r_r5c10_ohm}
rtaxel_r5c11 r5 c11 {r_r5c11_ohm}
rtaxel_r5c12 r5 c12 {r_r5c12_ohm}
rtaxel_r5c13 r5 c13 {r_r5c13_ohm}
rtaxel_r5c14 r5 c14 {r_r5c14_ohm}
rtaxel_r5c15 r5 c15 {r_r5c15_ohm}
rtaxel_r6c0 r6 c0 {r_r6c0_ohm}
rtaxel_r6c1 r6 c1 {r_r6c1_ohm}
rtaxel_r6c2 r6 c2 {r_r6c2_ohm}
rtaxel_r6c3 r6 c3 {r_r6c3_ohm}
rtaxel_r6c4 r6 c4 {r_r6c4_ohm}
rtaxel_r6c5 r6 c5 {r_r6c5_ohm}
rtaxel_r6c6 r6 c6 {r_r6c6_ohm}
rtaxel_r6c7 r6 c7 {r_r6c7_ohm}
rtaxel_r6c8 r6 c8 {r_r6c8_ohm}
rtaxel_r6c9 r6 c9 {r_r6c9_ohm}
rtaxel_r6c10 r6 c10 {r_r6c10_ohm}
rtaxel_r6c11 r6 c11 {r_r6c11_ohm}
rtaxel_r6c12 r6 c12 {r_r6c12_ohm}
rtaxel_r6c13 r6 c13 {r_r6c13_ohm}
rtaxel_r6c14 r6 c14 {r_r6c14_ohm}
rtaxel_r6c15 r6 c15 {r_r6c15_ohm}
rtaxel_r7c0 r7 c0 {r_r7c0_ohm}
rtaxel_r7c1 r7 c1 {r_r7c1_ohm}
rtaxel_r7c2 r7 c2 {r_r7c2_ohm}
rtaxel_r7c3 r7 c3 {r_r7c3_ohm}
rtaxel_r7c4 r7 c4 {r_r7c4_ohm}
rtaxel_r7c5 r7 c5 {r_r7c5_ohm}
rtaxel_r7c6 r7 c6 {r_r7c6_ohm}
rtaxel_r7c7 r7 c7 {r_r7c7_ohm}
rtaxel_r7c8 r7 c8 {r_r7c8_ohm}
rtaxel_r7c9 r7 c9 {r_r7c9_ohm}
rtaxel_r7c10 r7 c10 {r_r7c10_ohm}
rtaxel_r7c11 r7 c11 {r_r7c11_ohm}
rtaxel_r7c12 r7 c12 {r_r7c12_ohm}
rtaxel_r7c13 r7 c13 {r_r7c13_ohm}
rtaxel_r7c14 r7 c14 {r_r7c14_ohm}
rtaxel_r7c15 r7 c15 {r_r7c15_ohm}
rtaxel_r8c0 r8 c0 {r_r8c0_ohm}
rtaxel_r8c1 r8 c1 {r_r8c1_ohm}
rtaxel_r8c2 r8 c2 {r_r8c2_ohm}
rtaxel_r8c3 r8 c3 {r_r8c3_ohm}
rtaxel_r8c4 r8 c4 {r_r8c4_ohm}
rtaxel_r8c5 r8 c5 {r_r8c5_ohm}
rtaxel_r8c6 r8 c6 {r_r8c6_ohm}
rtaxel_r8c7 r8 c7 {r_r8c7_ohm}
rtaxel_r8c8 r8 c8 {r_r8c8_ohm}
rtaxel_r8c9 r8 c9 {r_r8c9_ohm}
rtaxel_r8c10 r8 c10 {r_r8c10_ohm}
rtaxel_r8c11 r8 c11 {r_r8c11_ohm}
rtaxel_r8c12 r8 c12 {r_r8c12_ohm}
rtaxel_r8c13 r8 c13 {r_r8c13_ohm}
rtaxel_r8c14 r8 c14 {r_r8c14_ohm}
rtaxel_r8c15 r8 c15 {r_r8c15_ohm}
rtaxel_r9c0 r9 c0 {r_r9c0_ohm}
rtaxel_r9c1 r9 c1 {r_r9c1_ohm}
rtaxel_r9c2 r9 c2 {r_r9c2_ohm}
rtaxel_r9c3 r9 c3 {r_r9c3_ohm}
rtaxel_r9c4 r9 c4 {r_r9c4_ohm}
rtaxel_r9c5 r9 c5 {r_r9c5_ohm}
rtaxel_r9c6 r9 c6 {r_r9c6_ohm}
rtaxel_r9c7 r9 c7 {r_r9c7_ohm}
rtaxel_r9c8 r9 c8 {r_r9c8_ohm}
rtaxel_r9c9 r9 c9 {r_r9c9_ohm}
rtaxel_r9c10 r9 c10 {r_r9c10_ohm}
rtaxel_r9c11 r9 c11 {r_r9c11_ohm}
rtaxel_r9c12 r9 c12 {r_r9c12_ohm}
rtaxel_r9c13 r9 c13 {r_r9c13_ohm}
rtaxel_r9c14 r9 c14 {r_r9c14_ohm}
rtaxel_r9c15 r9 c15 {r_r9c15_ohm}
rtaxel_r10c0 r10 c0 {r_r10c0_ohm}
rtaxel_r10c1 r10 c1 {r_r10c1_ohm}
rtaxel_r10c2 r10 c2 {r_r10c2_ohm}
rtaxel_r10c3 r10 c3 {r_r10c3_ohm}
rtaxel_r10c4 r10 c4 {r_r10c4_ohm}
rtaxel_r10c5 r10 c5 {r_r10c5_ohm}
rtaxel_r10c6 r10 c6 {r_r10c6_ohm}
rtaxel_r10c7 r10 c7 {r_r10c7_ohm}
rtaxel_r10c8 r10 c8 {r_r10c8_ohm}
rtaxel_r10c9 r10 c9 {r_r10c9_ohm}
rtaxel_r10c10 r10 c10 {r_r10c10_ohm}
rtaxel_r10c11 r10 c11 {r_r10c11_ohm}
rtaxel_r10c12 r10 c12 {r_r10c12_ohm}
rtaxel_r10c13 r10 c13 {r_r10c13_ohm}
rtaxel_r10c14 r10 c14 {r_r10c14_ohm}
rtaxel_r10c15 r10 c15 {r_r10c15_ohm}
rtaxel_r11c0 r11 c0 {r_r11c0_ohm}
rtaxel_r11c1 r11 c1 {r_r11c1_ohm}
rtaxel_r11c2 r11 c2 {r_r11c2_ohm}
rtaxel_r11c3 r11 c3 {r_r11c3_ohm}
rtaxel_r11c4 r11 c4 {r_r11c4_ohm}
rtaxel_r11c5 r11 c5 {r_r11c5_ohm}
rtaxel_r11c6 r11 c6 {r_r11c6_ohm}
rtaxel_r11c7 r11 c7 {r_r11c7_ohm}
rtaxel_r11c8 r11 c8 {r_r11c8_ohm}
rtaxel_r11c9 r11 c9 {r_r11c9_ohm}
rtaxel_r11c10 r11 c10 {r_r11c10_ohm}
rtaxel_r11c11 r11 c11 {r_r11c11_ohm}
rtaxel_r11c12 r11 c12 {r_r11c12_ohm}
rtaxel_r11c13 r11 c13 {r_r11c13_ohm}
rtaxel_r11c14 r11 c14 {r_r11c14_ohm}
rtaxel_r11c15 r11 c15 {r_r11c15_ohm}
rtaxel_r12c0 r12 c0 {r_r12c0_ohm}
rtaxel_r12c1 r12 c1 {r_r12c1_ohm}
rtaxel_r12c2 r12 c2 {r_r12c2_ohm}
rtaxel_r12c3 r12 c3 {r_r12c3_ohm}
rtaxel_r12c4 r12 c4 {r_r12c4_ohm}
rtaxel_r12c5 r12 c5 {r_r12c5_ohm}
rtaxel_r12c6 r12 c6 {r_r12c6_ohm}
rtaxel_r12c7 r12 c7 {r_r12c7_ohm}
rtaxel_r12c8 r12 c8 {r_r12c8_ohm}
rtaxel_r12c9 r12 c9 {r_r12c9_ohm}
rtaxel_r12c10 r12 c10 {r_r12c10_ohm}
rtaxel_r12c11 r12 c11 {r_r12c11_ohm}
rtaxel_r12c12 r12 c12 {r_r12c12_ohm}
rtaxel_r12c13 r12 c13 {r_r12c13_ohm}
rtaxel_r12c14 r12 c14 {r_r12c14_ohm}
rtaxel_r12c15 r12 c15 {r_r12c15_ohm}
rtaxel_r13c0 r13 c0 {r_r13c0_ohm}
rtaxel_r13c1 r13 c1 {r_r13c1_ohm}
rtaxel_r13c2 r13 c2 {r_r13c2_ohm}
rtaxel_r13c3 r13 c3 {r_r13c3_ohm}
rtaxel_r13c4 r13 c4 {r_r13c4_ohm}
rtaxel_r13c5 r13 c5 {r_r13c5_ohm}
rtaxel_r13c6 r13 c6 {r_r13c6_ohm}
rtaxel_r13c7 r13 c7 {r_r13c7_ohm}
rtaxel_r13c8 r13 c8 {r_r13c8_ohm}
rtaxel_r13c9 r13 c9 {r_r13c9_ohm}
rtaxel_r13c10 r13 c10 {r_r13c10_ohm}
rtaxel_r13c11 r13 c11 {r_r13c11_ohm}
rtaxel_r13c12 r13 c12 {r_r13c12_ohm}
rtaxel_r13c13 r13 c13 {r_r13c13_ohm}
rtaxel_r13c14 r13 c14 {r_r13c14_ohm}
rtaxel_r13c15 r13 c15 {r_r13c15_ohm}
rtaxel_r14c0 r14 c0 {r_r14c0_ohm}
rtaxel_r14c1 r14 c1 {r_r14c1_ohm}
rtaxel_r14c2 r14 c2 {r_r14c2_ohm}
rtaxel_r14c3 r14 c3 {r_r14c3_ohm}
rtaxel_r14c4 r14 c4 {r_r14c4_ohm}
rtaxel_r14c5 r14 c5 {r_r14c5_ohm}
rtaxel_r14c6 r14 c6 {r_r14c6_ohm}
rtaxel_r14c7 r14 c7 {r_r14c7_ohm}
rtaxel_r14c8 r14 c8 {r_r14c8_ohm}
rtaxel_r14c9 r14 c9 {r_r14c9_ohm}
rtaxel_r14c10 r14 c10 {r_r14c10_ohm}
rtaxel_r14c11 r14 c11 {r_r14c11_ohm}
rtaxel_r14c12 r14 c12 {r_r14c12_ohm}
rtaxel_r14c13 r14 c13 {r_r14c13_ohm}
rtaxel_r14c14 r14 c14 {r_r14c14_ohm}
rtaxel_r14c15 r14 c15 {r_r14c15_ohm}
rtaxel_r15c0 r15 c0 {r_r15c0_ohm}
rtaxel_r15c1 r15 c1 {r_r15c1_ohm}
rtaxel_r15c2 r15 c2 {r_r15c2_ohm}
rtaxel_r15c3 r15 c3 {r_r15c3_ohm}
rtaxel_r15c4 r15 c4 {r_r15c4_ohm}
rtaxel_r15c5 r15 c5 {r_r15c5_ohm}
rtaxel_r15c6 r15 c6 {r_r15c6_ohm}
rtaxel_r15c7 r15 c7 {r_r15c7_ohm}
rtaxel_r15c8 r15 c8 {r_r15c8_ohm}
rtaxel_r15c9 r15 c9 {r_r15c9_ohm}
rtaxel_r15c10 r15 c10 {r_r15c10_ohm}
rtaxel_r15c11 r15 c11 {r_r15c11_ohm}
rtaxel_r15c12 r15 c12 {r_r15c12_ohm}
rtaxel_r15c13 r15 c13 {r_r15c13_ohm}
rtaxel_r15c14 r15 c14 {r_r15c14_ohm}
rtaxel_r15c15 r15 c15 {r_r15c15_ohm}
.ends array
.subckt array_lateral
+ r0 r1 r2 r3 r4 r5 r6 r7 r8 r9 r10 r11 r12 r13 r14 r15
+ c0 c1 c2 c3 c4 c5 c6 c7 c8 c9 c10 c11 c12 c13 c14 c15
+ params: r_r0c0_ohm=64250.0 r_r0c1_ohm=64250.0 r_r0c2_ohm=64250.0 r_r0c3_ohm=64250.0
+ r_r0c4_ohm=64250.0 r_r0c5_ohm=64250.0 r_r0c6_ohm=64250.0 r_r0c7_ohm=64250.0
+ r_r0c8_ohm=64250.0 r_r0c9_ohm=64250.0 r_r0c10_ohm=64250.0 r_r0c11_ohm=64250.0
+ r_r0c12_ohm=64250.0 r_r0c13_ohm=64250.0 r_r0c14_ohm=64250.0 r_r0c15_ohm=64250.0
+ r_r1c0_ohm=64250.0 r_r1c1_ohm=64250.0 r_r1c2_ohm=64250.0 r_r1c3_ohm=64250.0
+ r_r1c4_ohm=64250.0 r_r1c5_ohm=64250.0 r_r1c6_ohm=64250.0 r_r1c7_ohm=64250.0
+ r_r1c8_ohm=64250.0 r_r1c9_ohm=64250.0 r_r1c10_ohm=64250.0 r_r1c11_ohm=64250.0
+ r_r1c12_ohm=64250.0 r_r1c13_ohm=64250.0 r_r1c14_ohm=64250.0 r_r1c15_ohm=64250.0
+ r_r2c0_ohm=64250.0 r_r2c1_ohm=64250.0 r_r2c2_ohm=64250.0 r_r2c3_ohm=64250.0
+ r_r2c4_ohm=64250.0 r_r2c5_ohm=64250.0 r_r2c6_ohm=64250.0 r_r2c7_ohm=64250.0
+ r_r2c8_ohm=64250.0 r_r2c9_ohm=64250.0 r_r2c10_ohm=64250.0 r_r2c11_ohm=64250.0
+ r_r2c12_ohm=64250.0 r_r2c13_ohm=64250.0 r_r2c14_ohm=64250.0 r_r2c15_ohm=64250.0
+ r_r3c0_ohm=64250.0 r_r3c1_ohm=64250.0 r_r3c2_ohm=64250.0 r_r3c3_ohm=64250.0
+ r_r3c4_ohm=64250.0 r_r3c5_ohm=64250.0 r_r3c6_ohm=64250.0 r_r3c7_ohm=64250.0
+ r_r3c8_ohm=64250.0 r_r3c9_ohm=64250.0 r_r3c10_ohm=64250.0 r_r3c11_ohm=64250.0
+ r_r3c12_ohm=64250.0 r_r3c13_ohm=64250.0 r_r3c14_ohm=64250.0 r_r3c15_ohm=64250.0
+ r_r4c0_ohm=64250.0 r_r4c1_ohm=64250.0 r_r4c2_ohm=64250.0 r_r4c3_ohm=64250.0
+ r_r4c4_ohm=64250.0 r_r4c5_ohm=64250.0 r_r4c6_ohm=64250.0 r_r4c7_ohm=64250.0
+ r_r4c8_ohm=64250.0 r_r4c9_ohm=64250.0 r_r4c10_ohm=64250.0 r_r4c11_ohm=64250.0
+ r_r4c12_ohm=64250.0 r_r4c13_ohm=64250.0 r_r4c14_ohm=64250.0 r_r4c15_ohm=64250.0
+ r_r5c0_ohm=64250.0 r_r5c1_ohm=64250.0 r_r5c2_ohm=64250.0 r_r5c3_ohm=64250.0
+ r_r5c4_ohm=64250.0 r_r5c5_ohm=64250.0 r_r5c6_ohm=64250.0 r_r5c7_ohm=64250.0
+ r_r5c8_ohm=64250.0 r_r5c9_ohm=64250.0 r_r5c10_ohm=64250.0 r_r5c11_ohm=64250.0
+ r_r5c12_ohm=64250.0 r_r5c13_ohm=64250.0 r_r5c14_ohm=64250.0 r_r5c15_ohm=64250.0
+ r_r6c0_ohm=64250.0 r_r6c1_ohm=64250.0 r_r6c2_ohm=64250.0 r_r6c3_ohm=64250.0
+ r_r6c4_ohm=64250.0 r_r6c5_ohm=64250.0 r_r6c6_ohm=64250.0 r_r6c7_ohm=64250.0
+ r_r6c8_ohm=64250.0 r_r6c9_ohm=64250.0 r_r6c10_ohm=64250.0 r_r6c11_ohm=64250.0
+ r_r6c12_ohm=64250.0 r_r6c13_ohm=64250.0 r_r6c14_ohm=64250.0 r_r6c15_ohm=64250.0
+ r_r7c0_ohm=64250.0 r_r7c1_ohm=64250.0 r_r7c2_ohm=64250.0 r_r7c3_ohm=64250.0
+ r_r7c4_ohm=64250.0 r_r7c5_ohm=64250.0 r_r7c6_ohm=64250.0 r_r7c7_ohm=64250.0
+ r_r7c8_ohm=64250.0 r_r7c9_ohm=64250.0 r_r7c10_ohm=64250.0 r_r7c11_ohm=64250.0
+ r_r7c12_ohm=64250.0 r_r7c13_ohm=64250.0 r_r7c14_ohm=64250.0 r_r7c15_ohm=64250.0
+ r_r8c0_ohm=64250.0 r_r8c1_ohm=64250.0 r_r8c2_ohm=64250.0 r_r8c3_ohm=64250.0
+ r_r8c4_ohm=64250.0 r_r8c5_ohm=64250.0 r_r8c6_ohm=64250.0 r_r8c7_ohm=64250.0
+ r_r8c8_ohm=64250.0 r_r8c9_ohm=64250.0 r_r8c10_ohm=64250.0 r_r8c11_ohm=64250.0
+ r_r8c12_ohm=64250.0 r_r8c13_ohm=64250.0 r_r8c14_ohm=64250.0 r_r8c15_ohm=64250.0
+ r_r9c0_ohm=64250.0 r_r9c1_ohm=64250.0 r_r9c2_ohm=64250.0 r_r9c3_ohm=64250.0
+ r_r9c4_ohm=64250.0 r_r9c5_ohm=64250.0 r_r9c6_ohm=64250.0 r_r9c7_ohm=64250.0
+ r_r9c8_ohm=64250.0 r_r9c9_ohm=64250.0 r_r9c10_ohm=64250.0 r_r9c11_ohm=64250.0
+ r_r9c12_ohm=64250.0 r_r9c13_ohm=64250.0 r_r9c14_ohm=64250.0 r_r9c15_ohm=64250.0
+ r_r10c0_ohm=64250.0 r_r10c1_ohm=64250.0 r_r10c2_ohm=64250.0 r_r10c3_ohm=64250.0
+ r_r10c4_ohm=64250.0 r_r10c5_ohm=64250.0 r_r10c6_ohm=64250.0 r_r10c7_ohm=64250.0
+ r_r10c8_ohm=64250.0 r_r10c9_ohm=64250.0 r_r10c10_ohm=64250.0 r_r10c11_ohm=64250.0
+ r_r10c12_ohm=64250.0 r_r10c13_ohm=64250.0 r_r10c14_ohm=64250.0 r_r10c15_ohm=64250.0
+ r_r11c0_ohm=64250.0 r_r11c1_ohm=64250.0 r_r11c2_ohm=64250.0 r_r11c3_ohm=64250.0
+ r_r11c4_ohm=64250.0 r_r11c5_ohm=64250.0 r_r11c6_ohm=64250.0 r_r11c7_ohm=64250.0
+ r_r11c8_ohm=64250.0 r_r11c9_ohm=64250.0 r_r11c10_ohm=64250.0 r_r11c11_ohm=64250.0
+ r_r11c12_ohm=64250.0 r_r11c13_ohm=64250.0 r_r11c14_ohm=64250.0 r_r11c15_ohm=64250.0
+ r_r12c0_ohm=64250.0 r_r12c1_ohm=64250.0 r_r12c2_ohm=64250.0 r_r12c3_ohm=64250.0
+ r_r12c4_ohm=64250.0 r_r12c5_ohm=64250.0 r_r12c6_ohm=64250.0 r_r12c7_ohm=64250.0
+ r_r12c8_ohm=64250.0 r_r12c9_ohm=64250.0 r_r12c10_ohm=64250.0 r_r12c11_ohm=64250.0
+ r_r12c12_ohm=64250.0 r_r12c13_ohm=64250.0 r_r12c14_ohm=64250.0 r_r12c15_ohm=64250.0
+ r_r13c0_ohm=64250.0 r_r13c1_ohm=64250.0 r_r13c2_ohm=64250.0 r_r13c3_ohm=64250.0
+ r_r13c4_ohm=64250.0 r_r13c5_ohm=64250.0 r_r13c6_ohm=64250.0 r_r13c7_ohm=64250.0
+ r_r13c8_ohm=64250.0 r_r13c9_ohm=64250.0 r_r13c10_ohm=64250.0 r_r13c11_ohm=64250.0
+ r_r13c12_ohm=64250.0 r_r13c13_ohm=64250.0 r_r13c14_ohm=64250.0 r_r13c15_ohm=64250.0
+ r_r14c0_ohm=64250.0 r_r14c1_ohm=64250.0 r_r14c2_ohm=64250.0 r_r14c3_ohm=64250.0
+ r_r14c4_ohm=64250.0 r_r14c5_ohm=64250.0 r_r14c6_ohm=64250.0 r_r14c7_ohm=64250.0
+ r_r14c8_ohm=64250.0 r_r14c9_ohm=64250.0 r_r14c10_ohm=64250.0 r_r14c11_ohm=64250.0
+ r_r14c12_ohm=64250.0 r_r14c13_ohm=64250.0 r_r14c14_ohm=64250.0 r_r14c15_ohm=64250.0
+ r_r15c0_ohm=64250.0 r_r15c1_ohm=64250.0 r_r15c2_ohm=64250.0 r_r15c3_ohm=64250.0
+ r_r15c4_ohm=64250.0 r_r15c5_ohm=64250.0 r_r15c6_ohm=64250.0 r_r15c7_ohm=64250.0
+ r_r15c8_ohm=64250.0 r_r15c9_ohm=64250.0 r_r15c10_ohm=64250.0 r_r15c11_ohm=64250.0
+ r_r15c12_ohm=64250.0 r_r15c13_ohm=64250.0 r_r15c14_ohm=64250.0 r_r15c15_ohm=64250.0
+ r_lateral_ohm=1000.0
rtaxel_r0c0 r0 c0 {r_r0c0_ohm}
rtaxel_r0c1 r0 c1 {r_r0c1_ohm}
rtaxel_r0c2 r0 c2 {r_r0c2_ohm}
rtaxel_r0c3 r0 c3 {r_r0c3_ohm}
rtaxel_r0c4 r0 c4 {r_r0c4_ohm}
rtaxel_r0c5 r0 c5 {r_r0c5_ohm}
rtaxel_r0c6 r0 c6 {r_r0c6_ohm}
rtaxel_r0c7 r0 c7 {r_r0c7_ohm}
rtaxel_r0c8 r0 c8 {r_r0c8_ohm}
rtaxel_r0c9 r0 c9 {r_r0c9_ohm}
rtaxel_r0c10 r0 c10 {r_r0c10_ohm}
rtaxel_r0c11 r0 c11 {r_r0c11_ohm}
rtaxel_r0c12 r0 c12 {r_r0c12_ohm}
rtaxel_r0c13 r0 c13 {r_r0c13_ohm}
rtaxel_r0c14 r0 c14 {r_r0c14_ohm}
rtaxel_r0c15 r0 c15 {r_r0c15_ohm}
rtaxel_r1c0 r1 c0 {r_r1c0_ohm}
rtaxel_r1c1 r1 c1 {r_r1c1_ohm}
rtaxel_r1c2 r1 c2 {r_r1c2_ohm}
rtaxel_r1c3 r1 c3 {r_r1c3_ohm}
rtaxel_r1c4 r1 c4 {r_r1c4_ohm}
rtaxel_r1c5 r1 c5 {r_r1c5_ohm}
rtaxel_r1c6 r1 c6 {r_r1c6_ohm}
rtaxel_r1c7 r1 c7 {r_r1c7_ohm}
rtaxel_r1c8 r1 c8 {r_r1c8_ohm}
rtaxel_r1c9 r1 c9 {r_r1c9_ohm}
rtaxel_r1c10 r1 c10 {r_r1c10_ohm}
rtaxel_r1c11 r1 c11 {r_r1c11_ohm}
rtaxel_r1c12 r1 c12 {r_r1c12_ohm}
rtaxel_r1c13 r1 c13 {r_r1c13_ohm}
rtaxel_r1c14 r1 c14 {r_r1c14_ohm}
rtaxel_r1c15 r1 c15 {r_r1c15_ohm}
rtaxel_r2c0 r2 c0 {r_r2c0_ohm}
rtaxel_r2c1 r2 c1 {r_r2c1_ohm}
rtaxel_r2c2 r2 c2 {r_r2c2_ohm}
rtaxel_r2c3 r2 c3 {r_r2c3_ohm}
rtaxel_r2c4 r2 c4 {r_r2c4_ohm}
rtaxel_r2c5 r2 c5 {r_r2c5_ohm}
rtaxel_r2c6 r2 c6 {r_r2c6_ohm}
rtaxel_r2c7 r2 c7 {r_r2c7_ohm}
rtaxel_r2c8 r2 c8 {r_r2c8_ohm}
rtaxel_r2c9 r2 c9 {r_r2c9_ohm}
rtaxel_r2c10 r2 c10 {r_r2c10_ohm}
rtaxel_r2c11 r2 c11 {r_r2c11_ohm}
rtaxel_r2c12 r2 c12 {r_r2c12_ohm}
rtaxel_r2c13 r2 c13 {r_r2c13_ohm}
rtaxel_r2c14 r2 c14 {r_r2c14_ohm}
rtaxel_r2c15 r2 c15 {r_r2c15_ohm}
rtaxel_r3c0 r3 c0 {r_r3c0_ohm}
rtaxel_r3c1 r3 c1 {r_r3c1_ohm}
rtaxel_r3c2 r3 c2 {r_r3c2_ohm}
rtaxel_r3c3 r3 c3 {r_r3c3_ohm}
rtaxel_r3c4 r3 c4 {r_r3c4_ohm}
rtaxel_r3c5 r3 c5 {r_r3c5_ohm}
rtaxel_r3c6 r3 c6 {r_r3c6_ohm}
rtaxel_r3c7 r3 c7 {r_r3c7_ohm}
rtaxel_r3c8 r3 c8 {r_r3c8_ohm}
rtaxel_r3c9 r3 c9 {r_r3c9_ohm}
rtaxel_r3c10 r3 c10 {r_r3c10_ohm}
rtaxel_r3c11 r3 c11 {r_r3c11_ohm}
rtaxel_r3c12 r3 c12 {r_r3c12_ohm}
rtaxel_r3c13 r3 c13 {r_r3c13_ohm}
rtaxel_r3c14 r3 c14 {r_r3c14_ohm}
rtaxel_r3c15 r3 c15 {r_r3c15_ohm}
rtaxel_r4c0 r4 c0 {r_r4c0_ohm}
rtaxel_r4c1 r4 c1 {r_r4c1_ohm}
rtaxel_r4c2 r4 c2 {r_r4c2_ohm}
rtaxel_r4c3 r4 c3 {r_r4c3_ohm}
rtaxel_r4c4 r4 c4 {r_r4c4_ohm}
rtaxel_r4c5 r4 c5 {r_r4c5_ohm}
rtaxel_r4c6 r4 c6 {r_r4c6_ohm}
rtaxel_r4c7 r4 c7 {r_r4c7_ohm}
rtaxel_r4c8 r4 c8 {r_r4c8_ohm}
rtaxel_r4c9 r4 c9 {r_r4c9_ohm}
rtaxel_r4c10 r4 c10 {r_r4c10_ohm}
rtaxel_r4c11 r4 c11 {r_r4c11_ohm}
rtaxel_r4c12 r4 c12 {r_r4c12_ohm}
rtaxel_r4c13 r4 c13 {r_r4c13_ohm}
rtaxel_r4c14 r4 c14 {r_r4c14_ohm}
rtaxel_r4c15 r4 c15 {r_r4c15_ohm}
rtaxel_r5c0 r5 c0 {r_r5c0_ohm}
rtaxel_r5c1 r5 c1 {r_r5c1_ohm}
rtaxel_r5c2 r5 c2 {r_r5c2_ohm}
rtaxel_r5c3 r5 c3 {r_r5c3_ohm}
rtaxel_r5c4 r5 c4 {r_r5c4_ohm}
rtaxel_r5c5 r5 c5 {r_r5c5_ohm}
rtaxel_r5c6 r5 c6 {r_r5c6_ohm}
rtaxel_r5c7 r5 c7 {r_r5c7_ohm}
rtaxel_r5c8 r5 c8 {r_r5c8_ohm}
rtaxel_r5c9 r5 c9 {r_r5c9_ohm}
rtaxel_r5c10 r5 c10 {r_r5c10_ohm}
rtaxel_r5c11 r5 c11 {r_r5c11_ohm}
rtaxel_r5c12 r5 c12 {r_r5c12_ohm}
rtaxel_r5c13 r5 c13 {r_r5c13_ohm}
rtaxel_r5c14 r5 c14 {r_r5c14_ohm}
rtaxel_r5c15 r5 c15 {r_r5c15_ohm}
rtaxel_r6c0 r6 c0 {r_r6c0_ohm}
rtaxel_r6c1 r6 c1 {r_r6c1_ohm}
rtaxel_r6c2 r6 c2 {r_r6c2_ohm}
rtaxel_r6c3 r6 c3 {r_r6c3_ohm}
rtaxel_r6c4 r6 c4 {r_r6c4_ohm}
rtaxel_r6c5 r6 c5 {r_r6c5_ohm}
rtaxel_r6c6 r6 c6 {r_r6c6_ohm}
rtaxel_r6c7 r6 c7 {r_r6c7_ohm}
rtaxel_r6c8 r6 c8 {r_r6c8_ohm}
rtaxel_r6c9 r6 c9 {r_r6c9_ohm}
rtaxel_r6c10 r6 c10 {r_r6c10_ohm}
rtaxel_r6c11 r6 c11 {r_r6c11_ohm}
rtaxel_r6c12 r6 c12 {r_r6c12_ohm}
rtaxel_r6c13 r6 c13 {r_r6c13_ohm}
rtaxel_r6c14 r6 c14 {r_r6c14_ohm}
rtaxel_r6c15 r6 c15 {r_r6c15_ohm}
rtaxel_r7c0 r7 c0 {r_r7c0_ohm}
rtaxel_r7c1 r7 c1 {r_r7c1_ohm}
rtaxel_r7c2 r7 c2 {r_r7c2_ohm}
rtaxel_r7c3 r7 c3 {r_r7c3_ohm}
rtaxel_r7c4 r7 c4 {r_r7c4_ohm}
rtaxel_r7c5 r7 c5 {r_r7c5_ohm}
rtaxel_r7c6 r7 c6 {r_r7c6_ohm}
rtaxel_r7c7 r7 c7 {r_r7c7_ohm}
rtaxel_r7c8 r7 c8 {r_r7c8_ohm}
rtaxel_r7c9 r7 c9 {r_r7c9_ohm}
rtaxel_r7c10 r7 c10 {r_r7c10_ohm}
rtaxel_r7c11 r7 c11 {r_r7c11_ohm}
rtaxel_r7c12 r7 c12 {r_r7c12_ohm}
rtaxel_r7c13 r7 c13 {r_r7c13_ohm}
rtaxel_r7c14 r7 c14 {r_r7c14_ohm}
rtaxel_r7c15 r7 c15 {r_r7c15_ohm}
rtaxel_r8c0 r8 c0 {r_r8c0_ohm}
rtaxel_r8c1 r8 c1 {r_r8c1_ohm}
rtaxel_r8c2 r8 c2 {r_r8c2_ohm}
rtaxel_r8c3 r8 c3 {r_r8c3_ohm}
rtaxel_r8c4 r8 c4 {r_r8c4_ohm}
rtaxel_r8c5 r8 c5 {r_r8c5_ohm}
rtaxel_r8c6 r8 c6 {r_r8c6_ohm}
rtaxel_r8c7 r8 c7 {r_r8c7_ohm}
rtaxel_r8c8 r8 c8 {r_r8c8_ohm}
rtaxel_r8c9 r8 c9 {r_r8c9_ohm}
rtaxel_r8c10 r8 c10 {r_r8c10_ohm}
rtaxel_r8c11 r8 c11 {r_r8c11_ohm}
rtaxel_r8c12 r8 c12 {r_r8c12_ohm}
rtaxel_r8c13 r8 c13 {r_r8c13_ohm}
rtaxel_r8c14 r8 c14 {r_r8c14_ohm}
rtaxel_r8c15 r8 c15 {r_r8c15_ohm}
rtaxel_r9c0 r9 c0 {r_r9c0_ohm}
rtaxel_r9c1 r9 c1 {r_r9c1_ohm}
rtaxel_r9c2 r9 c2 {r_r9c2_ohm}
rtaxel_r9c3 r9 c3 {r_r9c3_ohm}
rtaxel_r9c4 r9 c4 {r_r9c4_ohm}
rtaxel_r9c5 r9 c5 {r_r9c5_ohm}
rtaxel_r9c6 r9 c6 {r_r9c6_ohm}
rtaxel_r9c7 r9 c7 {r_r9c7_ohm}
rtaxel_r9c8 r9 c8 {r_r9c8_ohm}
rtaxel_r9c9 r9 c9 {r_r9c9_ohm}
rtaxel_r9c10 r9 c10 {r_r9c10_ohm}
rtaxel_r9c11 r9 c11 {r_r9c11_ohm}
rtaxel_r9c12 r9 c12 {r_r9c12_ohm}
rtaxel_r9c13 r9 c13 {r_r9c13_ohm}
rtaxel_r9c14 r9 c14 {r_r9c14_ohm}
rtaxel_r9c15 r9 c15 {r_r9c15_ohm}
rtaxel_r10c0 r10 c0 {r_r10c0_ohm}
rtaxel_r10c1 r10 c1 {r_r10c1_ohm}
rtaxel_r10c2 r10 c2 {r_r10c2_ohm}
rtaxel_r10c3 r10 c3 {r_r10c3_ohm}
rtaxel_r10c4 r10 c4 {r_r10c4_ohm}
rtaxel_r10c5 r10 c5 {r_r10c5_ohm}
rtaxel_r10c6 r10 c6 {r_r10c6_ohm}
rtaxel_r10c7 r10 c7 {r_r10c7_ohm}
rtaxel_r10c8 r10 c8 {r_r10c8_ohm}
rtaxel_r10c9 r10 c9 {r_r10c9_ohm}
rtaxel_r10c10 r10 c10 {r_r10c10_ohm}
rtaxel_r10c11 r10 c11 {r_r10c11_ohm}
rtaxel_r10c12 r10 c12 {r_r10c12_ohm}
rtaxel_r10c13 r10 c13 {r_r10c13_ohm}
rtaxel_r10c14 r10 c14 {r_r10c14_ohm}
rtaxel_r10c15 r10 c15 {r_r10c15_ohm}
rtaxel_r11c0 r11 c0 {r_r11c0_ohm}
rtaxel_r11c1 r11 c1 {r_r11c1_ohm}
rtaxel_r11c2 r11 c2 {r_r11c2_ohm}
rtaxel_r11c3 r11 c3 {r_r11c3_ohm}
rtaxel_r11c4 r11 c4 {r_r11c4_ohm}
rtaxel_r11c5 r11 c5 {r_r11c5_ohm}
rtaxel_r11c6 r11 c6 {r_r11c6_ohm}
rtaxel_r11c7 r11 c7 {r_r11c7_ohm}
rtaxel_r11c8 r11 c8 {r_r11c8_ohm}
rtaxel_r11c9 r11 c9 {r_r11c9_ohm}
rtaxel_r11c10 r11 c10 {r_r11c10_ohm}
rtaxel_r11c11 r11 c11 {r_r11c11_ohm}
rtaxel_r11c12 r11 c12 {r_r11c12_ohm}
rtaxel_r11c13 r11 c13 {r_r11c13_ohm}
rtaxel_r11c14 r11 c14 {r_r11c14_ohm}
rtaxel_r11c15 r11 c15 {r_r11c15_ohm}
rtaxel_r12c0 r12 c0 {r_r12c0_ohm}
rtaxel_r12c1 r12 c1 {r_r12c1_ohm}
rtaxel_r12c2 r12 c2 {r_r12c2_ohm}
rtaxel_r12c3 r12 c3 {r_r12c3_ohm}
rtaxel_r12c4 r12 c4 {r_r12c4_ohm}
rtaxel_r12c5 r12 c5 {r_r12c5_ohm}
rtaxel_r12c6 r12 c6 {r_r12c6_ohm}
rtaxel_r12c7 r12 c7 {r_r12c7_ohm}
rtaxel_r12c8 r12 c8 {r_r12c8_ohm}
rtaxel_r12c9 r12 c9 {r_r12c9_ohm}
rtaxel_r12c10 r12 c10 {r_r12c10_ohm}
rtaxel_r12c11 r12 c11 {r_r12c11_ohm}
rtaxel_r12c12 r12 c12 {r_r12c12_ohm}
rtaxel_r12c13 r12 c13 {r_r12c13_ohm}
rtaxel_r12c14 r12 c14 {r_r12c14_ohm}
rtaxel_r12c15 r12 c15 {r_r12c15_ohm}
rtaxel_r13c0 r13 c0 {r_r13c0_ohm}
rtaxel_r13c1 r13 c1 {r_r13c1_ohm}
rtaxel_r13c2 r13 c2 {r_r13c2_ohm}
rtaxel_r13c3 r13 c3 {r_r13c3_ohm}
rtaxel_r13c4 r13 c4 {r_r13c4_ohm}
rtaxel_r13c5 r13 c5 {r_r13c5_ohm}
rtaxel_r13c6 r13 c6 {r_r13c6_ohm}
rtaxel_r13c7 r13 c7 {r_r13c7_ohm}
rtaxel_r13c8 r13 c8 {r_r13c8_ohm}
rtaxel_r13c9 r13 c9 {r_r13c9_ohm}
rtaxel_r13c10 r13 c10 {r_r13c10_ohm}
rtaxel_r13c11 r13 c11 {r_r13c11_ohm}
rtaxel_r13c12 r13 c12 {r_r13c12_ohm}
rtaxel_r13c13 r13 c13 {r_r13c13_ohm}
rtaxel_r13c14 r13 c14 {r_r13c14_ohm}
rtaxel_r13c15 r13 c15 {r_r13c15_ohm}
rtaxel_r14c0 r14 c0 {r_r14c0_ohm}
rtaxel_r14c1 r14 c1 {r_r14c1_ohm}
rtaxel_r14c2 r14 c2 {r_r14c2_ohm}
rtaxel_r14c3 r14 c3 {r_r14c3_ohm}
rtaxel_r14c4 r14 c4 {r_r14c4_ohm}
rtaxel_r14c5 r14 c5 {r_r14c5_ohm}
rtaxel_r14c6 r14 c6 {r_r14c6_ohm}
rtaxel_r14c7 r14 c7 {r_r14c7_ohm}
rtaxel_r14c8 r14 c8 {r_r14c8_ohm}
rtaxel_r14c9 r14 c9 {r_r14c9_ohm}
rtaxel_r14c10 r14 c10 {r_r14c10_ohm}
rtaxel_r14c11 r14 c11 {r_r14c11_ohm}
rtaxel_r14c12 r14 c12 {r_r14c12_ohm}
rtaxel_r14c13 r14 c13 {r_r14c13_ohm}
rtaxel_r14c14 r14 c14 {r_r14c14_ohm}
rtaxel_r14c15 r14 c15 {r_r14c15_ohm}
rtaxel_r15c0 r15 c0 {r_r15c0_ohm}
rtaxel_r15c1 r15 c1 {r_r15c1_ohm}
rtaxel_r15c2 r15 c2 {r_r15c2_ohm}
rtaxel_r15c3 r15 c3 {r_r15c3_ohm}
rtaxel_r15c4 r15 c4 {r_r15c4_ohm}
rtaxel_r15c5 r15 c5 {r_r15c5_ohm}
rtaxel_r15c6 r15 c6 {r_r15c6_ohm}
rtaxel_r15c7 r15 c7 {r_r15c7_ohm}
rtaxel_r15c8 r15 c8 {r_r15c8_ohm}
rtaxel_r15c9 r15 c9 {r_r15c9_ohm}
rtaxel_r15c10 r15 c10 {r_r15c10_ohm}
rtaxel_r15c11 r15 c11 {r_r15c11_ohm}
rtaxel_r15c12 r15 c12 {r_r15c12_ohm}
rtaxel_r15c13 r15 c13 {r_r15c13_ohm}
rtaxel_r15c14 r15 c14 {r_r15c14_ohm}
rtaxel_r15c15 r15 c15 {r_r15c15_ohm}
rlat_r0c0 c0 c1 {r_lateral_ohm}
rlat_r0c1 c1 c2 {r_lateral_ohm}
rlat_r0c2 c2 c3 {r_lateral_ohm}
rlat_r0c3 c3 c4 {r_lateral_ohm}
rlat_r0c4 c4 c5 {r_lateral_ohm}
rlat_r0c5 c5 c6 {r_lateral_ohm}
rlat_r0c6 c6 c7 {r_lateral_ohm}
rlat_r0c7 c7 c8 {r_lateral_ohm}
rlat_r0c8 c8 c9 {r_lateral_ohm}
rlat_r0c9 c9 c10 {r_lateral_ohm}
rlat_r0c10 c10 c11 {r_lateral_ohm}
rlat_r0c11 c11 c12 {r_lateral_ohm}
rlat_r0c12 c12 c13 {r_lateral_ohm}
rlat_r0c13 c13 c14 {r_lateral_ohm}
rlat_r0c14 c14 c15 {r_lateral_ohm}
rlat_r1c0 c0 c1 {r_lateral_ohm}
rlat_r1c1 c1 c2 {r_lateral_ohm}
rlat_r1c2 c2 c3 {r_lateral_ohm}
rlat_r1c3 c3 c4 {r_lateral_ohm}
rlat_r1c4 c4 c5 {r_lateral_ohm}
rlat_r1c5 c5 c6 {r_lateral_ohm}
rlat_r1c6 c6 c7 {r_lateral_ohm}
rlat_r1c7 c7 c8 {r_lateral_ohm}
rlat_r1c8 c8 c9 {r_lateral_ohm}
rlat_r1c9 c9 c10 {r_lateral_ohm}
rlat_r1c10 c10 c11 {r_lateral_ohm}
rlat_r1c11 c11 c12 {r_lateral_ohm}
rlat_r1c12 c12 c13 {r_lateral_ohm}
rlat_r1c13 c13 c14 {r_lateral_ohm}
rlat_r1c14 c14 c15 {r_lateral_ohm}
rlat_r2c0 c0 c1 {r_lateral_ohm}
rlat_r2c1 c1 c2 {r_lateral_ohm}
rlat_r2c2 c2 c3 {r_lateral_ohm}
rlat_r2c3 c3 c4 {r_lateral_ohm}
rlat_r2c4 c4 c5 {r_lateral_ohm}
rlat_r2c5 c5 c6 {r_lateral_ohm}
rlat_r2c6 c6 c7 {r_lateral_ohm}
rlat_r2c7 c7 c8 {r_lateral_ohm}
rlat_r2c8 c8 c9 {r_lateral_ohm}
rlat_r2c9 c9 c10 {r_lateral_ohm}
rlat_r2c10 c10 c11 {r_lateral_ohm}
rlat_r2c11 c11 c12 {r_lateral_ohm}
rlat_r2c12 c12 c13 {r_lateral_ohm}
rlat_r2c13 c13 c14 {r_lateral_ohm}
rlat_r2c14 c14 c15 {r_lateral_ohm}
rlat_r3c0 c0 c1 {r_lateral_ohm}
rlat_r3c1 c1 c2 {r_lateral_ohm}
rlat_r3c2 c2 c3 {r_lateral_ohm}
rlat_r3c3 c3 c4 {r_lateral_ohm}
rlat_r3c4 c4 c5 {r_lateral_ohm}
rlat_r3c5 c5 c6 {r_lateral_ohm}
rlat_r3c6 c6 c7 {r_lateral_ohm}
rlat_r3c7 c7 c8 {r_lateral_ohm}
rlat_r3c8 c8 c9 {r_lateral_ohm}
rlat_r3c9 c9 c10 {r_lateral_ohm}
rlat_r3c10 c10 c11 {r_lateral_ohm}
rlat_r3c11 c11 c12 {r_lateral_ohm}
rlat_r3c12 c12 c13 {r_lateral_ohm}
rlat_r3c13 c13 c14 {r_lateral_ohm}
rlat_r3c14 c14 c15 {r_lateral_ohm}
rlat_r4c0 c0 c1 {r_lateral_ohm}
rlat_r4c1 c1 c2 {r_lateral_ohm}
rlat_r4c2 c2 c3 {r_lateral_ohm}
rlat_r4c3 c3 c4 {r_lateral_ohm}
rlat_r4c4 c4 c5 {r_lateral_ohm}
rlat_r4c5 c5 c6 {r_lateral_ohm}
rlat_r4c6 c6 c7 {r_lateral_ohm}
rlat_r4c7 c7 c8 {r_lateral_ohm}
rlat_r4c8 c8 c9 {r_lateral_ohm}
rlat_r4c9 c9 c10 {r_lateral_ohm}
rlat_r4c10 c10 c11 {r_lateral_ohm}
rlat_r4c11 c11 c12 {r_lateral_ohm}
rlat_r4c12 c12 c13 {r_lateral_ohm}
rlat_r4c13 c13 c14 {r_lateral_ohm}
rlat_r4c14 c14 c15 {r_lateral_ohm}
rlat_r5c0 c0 c1 {r_lateral_ohm}
rlat_r5c1 c1 c2 {r_lateral_ohm}
rlat_r5c2 c2 c3 {r_lateral_ohm}
rlat_r5c3 c3 c4 {r_lateral_ohm}
rlat_r5c4 c4 c5 {r_lateral_ohm}
rlat_r5c5 c5 c6 {r_lateral_ohm}
rlat_r5c6 c6 c7 {r_lateral_ohm}
rlat_r5c7 c7 c8 {r_lateral_ohm}
rlat_r5c8 c8 c9 {r_lateral_ohm}
rlat_r5c9 c9 c10 {r_lateral_ohm}
rlat_r5c10 c10 c11 {r_lateral_ohm}
rlat_r5c11 c11 c12 {r_lateral_ohm}
rlat_r5c12 c12 c13 {r_lateral_ohm}
rlat_r5c13 c13 c14 {r_lateral_ohm}
rlat_r5c14 c14 c15 {r_lateral_ohm}
rlat_r6c0 c0 c1 {r_lateral_ohm}
rlat_r6c1 c1 c2 {r_lateral_ohm}
rlat_r6c2 c2 c3 {r_lateral_ohm}
rlat_r6c3 c3 c4 {r_lateral_ohm}
rlat_r6c4 c4 c5 {r_lateral_ohm}
rlat_r6c5 c5 c6 {r_lateral_ohm}
rlat_r6c6 c6 c7 {r_lateral_ohm}
rlat_r6c7 c7 c8 {r_lateral_ohm}
rlat_r6c8 c8 c9 {r_lateral_ohm}
rlat_r6c9 c9 c10 {r_lateral_ohm}
rlat_r6c10 c10 c11 {r_lateral_ohm}
rlat_r6c11 c11 c12 {r_lateral_ohm}
rlat_r6c12 c12 c13 {r_lateral_ohm}
rlat_r6c13 c13 c14 {r_lateral_ohm}
rlat_r6c14 c14 c15 {r_lateral_ohm}
rlat_r7c0 c0 c1 {r_lateral_ohm}
rlat_r7c1 c1 c2 {r_lateral_ohm}
rlat_r7c2 c2 c3 {r_lateral_ohm}
rlat_r7c3 c3 c4 {r_lateral_ohm}
rlat_r7c4 c4 c5 {r_lateral_ohm}
rlat_r7c5 c5 c6 {r_lateral_ohm}
rlat_r7c6 c6 c7 {r_lateral_ohm}
rlat_r7c7 c7 c8 {r_lateral_ohm}
rlat_r7c8 c8 c9 {r_lateral_ohm}
rlat_r7c9 c9 c10 {r_lateral_ohm}
rlat_r7c10 c10 c11 {r_lateral_ohm}
rlat_r7c11 c11 c12 {r_lateral_ohm}
rlat_r7c12 c12 c13 {r_lateral_ohm}
rlat_r7c13 c13 c14 {r_lateral_ohm}
rlat_r7c14 c14 c15 {r_lateral_ohm}
rlat_r8c0 c0 c1 {r_lateral_ohm}
rlat_r8c1 c1 c2 {r_lateral_ohm}
rlat_r8c2 c2 c3 {r_lateral_ohm}
rlat_r8c3 c3 c4 {r_lateral_ohm}
rlat_r8c4 c4 c5 {r_lateral_ohm}
rlat_r8c5 c5 c6 {r_lateral_ohm}
rlat_r8c6 c6 c7 {r_lateral_ohm}
rlat_r8c7 c7 c8 {r_lateral_ohm}
rlat_r8c8 c8 c9 {r_lateral_ohm}
rlat_r8c9 c9 c10 {r_lateral_ohm}
rlat_r8c10 c10 c11 {r_lateral_ohm}
rlat_r8c11 c11 c12 {r_lateral_ohm}
rlat_r8c12 c12 c13 {r_lateral_ohm}
rlat_r8c13 c13 c14 {r_lateral_ohm}
rlat_r8c14 c14 c15 {r_lateral_ohm}
rlat_r9c0 c0 c1 {r_lateral_ohm}
rlat_r9c1 c1 c2 {r_lateral_ohm}
rlat_r9c2 c2 c3 {r_lateral_ohm}
rlat_r9c3 c3 c4 {r_lateral_ohm}
rlat_r9c4 c4 c5 {r_lateral_ohm}
rlat_r9c5 c5 c6 {r_lateral_ohm}
rlat_r9c6 c6 c7 {r_lateral_ohm}
rlat_r9c7 c7 c8 {r_lateral_ohm}
rlat_r9c8 c8 c9 {r_lateral_ohm}
rlat_r9c9 c9 c10 {r_lateral_ohm}
rlat_r9c10 c10 c11 {r_lateral_ohm}
rlat_r9c11 c11 c12 {r_lateral_ohm}
rlat_r9c12 c12 c13 {r_lateral_ohm}
rlat_r9c13 c13 c14 {r_lateral_ohm}
rlat_r9c14 c14 c15 {r_lateral_ohm}
rlat_r10c0 c0 c1 {r_lateral_ohm}
rlat_r10c1 c1 c2 {r_lateral_ohm}
rlat_r10c2 c2 c3 {r_lateral_ohm}
rlat_r10c3 c3 c4 {r_lateral_ohm}
rlat_r10c4 c4 c5 {r_lateral_ohm}
rlat_r10c5 c5 c6 {r_lateral_ohm}
rlat_r10c6 c6 c7 {r_lateral_ohm}
rlat_r10c7 c7 c8 {r_lateral_ohm}
rlat_r10c8 c8 c9 {r_lateral_ohm}
rlat_r10c9 c9 c10 {r_lateral_ohm}
rlat_r10c10 c10 c11 {r_lateral_ohm}
rlat_r10c11 c11 c12 {r_lateral_ohm}
rlat_r10c12 c12 c13 {r_lateral_ohm}
rlat_r10c13 c13 c14 {r_lateral_ohm}
rlat_r10c14 c14 c15 {r_lateral_ohm}
rlat_r11c0 c0 c1 {r_lateral_ohm}
rlat_r11c1 c1 c2 {r_lateral_ohm}
rlat_r11c2 c2 c3 {r_lateral_ohm}
rlat_r11c3 c3 c4 {r_lateral_ohm}
rlat_r11c4 c4 c5 {r_lateral_ohm}
rlat_r11c5 c5 c6 {r_lateral_ohm}
rlat_r11c6 c6 c7 {r_lateral_ohm}
rlat_r11c7 c7 c8 {r_lateral_ohm}
rlat_r11c8 c8 c9 {r_lateral_ohm}
rlat_r11c9 c9 c10 {r_lateral_ohm}
rlat_r11c10 c10 c11 {r_lateral_ohm}
rlat_r11c11 c11 c12 {r_lateral_ohm}
rlat_r11c12 c12 c13 {r_lateral_ohm}
rlat_r11c13 c13 c14 {r_lateral_ohm}
rlat_r11c14 c14 c15 {r_lateral_ohm}
rlat_r12c0 c0 c1 {r_lateral_ohm}
rlat_r12c1 c1 c2 {r_lateral_ohm}
rlat_r12c2 c2 c3 {r_lateral_ohm}
rlat_r12c3 c3 c4 {r_lateral_ohm}
rlat_r12c4 c4 c5 {r_lateral_ohm}
rlat_r12c5 c5 c6 {r_lateral_ohm}
rlat_r12c6 c6 c7 {r_lateral_ohm}
rlat_r12c7 c7 c8 {r_lateral_ohm}
rlat_r12c8 c8 c9 {r_lateral_ohm}
rlat_r12c9 c9 c10 {r_lateral_ohm}
rlat_r12c10 c10 c11 {r_lateral_ohm}
rlat_r12c11 c11 c12 {r_lateral_ohm}
rlat_r12c12 c12 c13 {r_lateral_ohm}
rlat_r12c13 c13 c14 {r_lateral_ohm}
rlat_r12c14 c14 c15 {r_lateral_ohm}
rlat_r13c0 c0 c1 {r_lateral_ohm}
rlat_r13c1 c1 c2 {r_lateral_ohm}
rlat_r13c2 c2 c3 {r_lateral_ohm}
rlat_r13c3 c3 c4 {r_lateral_ohm}
rlat_r13c4 c4 c5 {r_lateral_ohm}
rlat_r13c5 c5 c6 {r_lateral_ohm}
rlat_r13c6 c6 c7 {r_lateral_ohm}
rlat_r13c7 c7 c8 {r_lateral_ohm}
rlat_r13c8 c8 c9 {r_lateral_ohm}
rlat_r13c9 c9 c10 {r_lateral_ohm}
rlat_r13c10 c10 c11 {r_lateral_ohm}
rlat_r13c11 c11 c12 {r_lateral_ohm}
rlat_r13c12 c12 c13 {r_lateral_ohm}
rlat_r13c13 c13 c14 {r_lateral_ohm}
rlat_r13c14 c14 c15 {r_lateral_ohm}
rlat_r14c0 c0 c1 {r_lateral_ohm}
rlat_r14c1 c1 c2 {r_lateral_ohm}
rlat_r14c2 c2 c3 {r_lateral_ohm}
rlat_r14c3 c3 c4 {r_lateral_ohm}
rlat_r14c4 c4 c5 {r_lateral_ohm}
rlat_r14c5 c5 c6 {r_lateral_ohm}
rlat_r14c6 c6 c7 {r_lateral_ohm}
rlat_r14c7 c7 c8 {r_lateral_ohm}
rlat_r14c8 c8 c9 {r_lateral_ohm}
rlat_r14c9 c9 c10 {r_lateral_ohm}
rlat_r14c10 c10 c11 {r_lateral_ohm}
rlat_r14c11 c11 c12 {r_lateral_ohm}
rlat_r14c12 c12 c13 {r_lateral_ohm}
rlat_r14c13 c13 c14 {r_lateral_ohm}
rlat_r14c14 c14 c15 {r_lateral_ohm}
rlat_r15c0 c0 c1 {r_lateral_ohm}
rlat_r15c1 c1 c2 {r_lateral_ohm}
rlat_r15c2 c2 c3 {r_lateral_ohm}
rlat_r15c3 c3 c4 {r_lateral_ohm}
rlat_r15c4 c4 c5 {r_lateral_ohm}
rlat_r15c5 c5 c6 {r_lateral_ohm}
rlat_r15c6 c6 c7 {r_lateral_ohm}
rlat_r15c7 c7 c8 {r_lateral_ohm}
rlat_r15c8 c8 c9 {r_lateral_ohm}
rlat_r15c9 c9 c10 {r_lateral_ohm}
rlat_r15c10 c10 c11 {r_lateral_ohm}
rlat_r15c11 c11 c12 {r_lateral_ohm}
rlat_r15c12 c12 c13 {r_lateral_ohm}
rlat_r15c13 c13 c14 {r_lateral_ohm}
rlat_r15c14 c14 c15 {r_lateral_ohm}
.ends array_lateral
