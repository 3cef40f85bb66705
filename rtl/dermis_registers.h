/* SPDX-License-Identifier: Apache-2.0 */
/* Register map for firmware. Generated from rtl/dermis_registers.rdl; change it there and run: dermis generate */
/* Addresses are those of the SPI commands; a list goes on from its own, one address a word. */
#ifndef DERMIS_REGISTERS_H
#define DERMIS_REGISTERS_H

#define DERMIS_ID                             0x00u
#define DERMIS_GEOMETRY                       0x01u
#define DERMIS_FORMAT                         0x02u
#define DERMIS_CONTROL                        0x03u
#define DERMIS_SETTLE                         0x04u
#define DERMIS_GATE                           0x05u
#define DERMIS_RANGE                          0x06u
#define DERMIS_STATUS                         0x07u
#define DERMIS_FRAME_NUMBER                   0x08u
#define DERMIS_LOST                           0x09u
#define DERMIS_SPI_ERRORS                     0x0Au
#define DERMIS_TEST_RATE                      0x0Bu
#define DERMIS_TEST_COUNT                     0x0Cu
#define DERMIS_DARK_MAX                       0x0Du
#define DERMIS_FULL_MIN                       0x0Eu
#define DERMIS_ROW_MASK                       0x20u
#define DERMIS_ROW_FAULT                      0x28u
#define DERMIS_INJECT_FAULT                   0x30u
#define DERMIS_DARK_FAULT                     0x38u
#define DERMIS_FULL_FAULT                     0x40u
#define DERMIS_RANGE_COLUMN                   0x50u
#define DERMIS_PEDESTAL                       0x80u
#define DERMIS_GEOMETRY_COLS_MASK             0x00FFu
#define DERMIS_GEOMETRY_COLS_SHIFT            0u
#define DERMIS_GEOMETRY_ROWS_MASK             0xFF00u
#define DERMIS_GEOMETRY_ROWS_SHIFT            8u
#define DERMIS_FORMAT_CODE_BITS_MASK          0x001Fu
#define DERMIS_FORMAT_CODE_BITS_SHIFT         0u
#define DERMIS_FORMAT_SYNC_LATCH_MASK         0x0100u
#define DERMIS_FORMAT_SYNC_LATCH_SHIFT        8u
#define DERMIS_FORMAT_BREAK_CLOCKS_MASK       0xFE00u
#define DERMIS_FORMAT_BREAK_CLOCKS_SHIFT      9u
#define DERMIS_CONTROL_CONTINUOUS_MASK        0x0001u
#define DERMIS_CONTROL_CONTINUOUS_SHIFT       0u
#define DERMIS_CONTROL_SHOT_MASK              0x0002u
#define DERMIS_CONTROL_SHOT_SHIFT             1u
#define DERMIS_CONTROL_TEST_MASK              0x0004u
#define DERMIS_CONTROL_TEST_SHIFT             2u
#define DERMIS_CONTROL_DARK_MASK              0x0008u
#define DERMIS_CONTROL_DARK_SHIFT             3u
#define DERMIS_CONTROL_PEDESTAL_MODE_MASK     0x0030u
#define DERMIS_CONTROL_PEDESTAL_MODE_SHIFT    4u
#define DERMIS_CONTROL_RANGE_PER_COLUMN_MASK  0x0040u
#define DERMIS_CONTROL_RANGE_PER_COLUMN_SHIFT 6u
#define DERMIS_CONTROL_HOLD_MASK              0x0080u
#define DERMIS_CONTROL_HOLD_SHIFT             7u
#define DERMIS_RANGE_RANGE_MASK               0x0003u
#define DERMIS_RANGE_RANGE_SHIFT              0u
#define DERMIS_STATUS_SCANNING_MASK           0x0001u
#define DERMIS_STATUS_SCANNING_SHIFT          0u
#define DERMIS_STATUS_FRAME_READY_MASK        0x0002u
#define DERMIS_STATUS_FRAME_READY_SHIFT       1u
#define DERMIS_STATUS_TEST_DONE_MASK          0x0004u
#define DERMIS_STATUS_TEST_DONE_SHIFT         2u
#define DERMIS_STATUS_FAULT_MASK              0x0008u
#define DERMIS_STATUS_FAULT_SHIFT             3u
#define DERMIS_STATUS_TEST_CUT_MASK           0x0010u
#define DERMIS_STATUS_TEST_CUT_SHIFT          4u
#define DERMIS_STATUS_UNDERFLOW_MASK          0x0020u
#define DERMIS_STATUS_UNDERFLOW_SHIFT         5u
#define DERMIS_CONTROL_RESET                  0x0001u
#define DERMIS_SETTLE_RESET                   0x0073u
#define DERMIS_GATE_RESET                     0x01FEu
#define DERMIS_RANGE_RESET                    0x0002u
#define DERMIS_TEST_RATE_RESET                0x4000u
#define DERMIS_DARK_MAX_RESET                 0x0008u
#define DERMIS_FULL_MIN_RESET                 0x00B7u
#define DERMIS_ROW_MASK_RESET                 0xFFFFu
#define DERMIS_RANGE_COLUMN_RESET             0xAAAAu
#define DERMIS_PEDESTAL_RESET                 0x0000u

#endif
