// SPDX-License-Identifier: Apache-2.0
// The one list of synthesizable sources, for Icarus (-c), Verilator (-f) and Yosys (read by scripts.lint); paths from the project root.
+incdir+rtl
rtl/dermis_tech_dff.v
rtl/dermis_tech_latch.v
rtl/dermis_tech_ram.v
rtl/dermis_tech_sync.v
rtl/dermis_sync_ff.v
rtl/dermis_sync_latch.v
rtl/dermis_gated_counter.v
rtl/dermis_row_scanner.v
rtl/dermis_row_buffer.v
rtl/dermis_reader.v
rtl/dermis_crc16.v
rtl/dermis_crc8.v
rtl/dermis_frame_buffer.v
rtl/dermis_register_port.v
rtl/dermis_registers.v
rtl/dermis_reset_sync.v
rtl/dermis_packer.v
rtl/dermis_self_test.v
rtl/dermis_spi.v
rtl/dermis_safe_outputs.v
rtl/dermis_top.v
