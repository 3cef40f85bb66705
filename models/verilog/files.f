// SPDX-License-Identifier: Apache-2.0
// Real-number models, after the files of rtl/files.f; paths from the project root.
+incdir+models/verilog
models/verilog/two_exponentials.sv
models/verilog/array.sv
models/verilog/drive.sv
models/verilog/course.sv
models/verilog/mirror.sv
models/verilog/conveyor.sv
models/verilog/conveyor_multi.sv
models/verilog/charge_source.sv
models/verilog/integrator_piece.sv
models/verilog/integrator.sv
models/verilog/comparator.sv
models/verilog/vfc.sv
models/verilog/channel_direct.sv
models/verilog/channel_conveyor_mirror.sv
models/verilog/channel_conveyor_mirror_inverted.sv
models/verilog/channel_multi_output_conveyor.sv
models/verilog/spi_host.sv
models/verilog/skin.sv
