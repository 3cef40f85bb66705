// SPDX-License-Identifier: Apache-2.0
// Drives register_chip: each input is a length (4 bytes, low first) and a stream of commands; the answer likewise.
// 0x00 b: eight bits of b, CS as it is, one byte answered;  0x01 n b: the first n % 8 bits of b, nothing answered;
// 0x02: CS low;  0x03: CS high;  0x04: reset for some clocks, CS as it is. Behind each input: errors and pulses, two
// bytes each, high byte first, and the chip is reset. Any other command is taken as 0x03.
#include <cstdint>
#include <cstdio>
#include <memory>
#include <vector>

#include "Vregister_chip.h"
#include "verilated.h"

// A period of SCK lasts so many half clocks: SCK at an eighth of the clock, so that an answer has one wait byte.
static const int half_clocks = 8;

static std::unique_ptr<Vregister_chip> chip;

static void clocks(int halves) {
  for (int i = 0; i < halves; ++i) {
    chip->clk_i = !chip->clk_i;
    chip->eval();
  }
}

static int bit(int value) {
  chip->copi_i = value;
  clocks(half_clocks);
  const int got = chip->cipo_o;
  chip->sck_i = 1;
  clocks(half_clocks);
  chip->sck_i = 0;
  clocks(2);
  return got;
}

static void reset() {
  chip->rst_ni = 0;
  chip->eval();
  clocks(8);
  chip->rst_ni = 1;
  chip->eval();
  clocks(8);
}

static bool read_exactly(uint8_t *to, size_t count) { return fread(to, 1, count, stdin) == count; }

int main() {
  chip = std::make_unique<Vregister_chip>();
  uint8_t size[4];
  std::vector<uint8_t> in, out;
  while (read_exactly(size, 4)) {
    in.resize(size[0] | size[1] << 8 | size[2] << 16 | size_t(size[3]) << 24);
    if (!in.empty() && !read_exactly(in.data(), in.size())) return 1;
    out.clear();
    chip->cs_ni = 1;
    chip->sck_i = 0;
    chip->copi_i = 0;
    reset();
    for (size_t at = 0; at < in.size(); ++at) {
      const uint8_t command = in[at];
      if (command == 0 && at + 1 < in.size()) {
        const uint8_t byte = in[++at];
        int got = 0;
        for (int n = 7; n >= 0; --n) got = got << 1 | bit(byte >> n & 1);
        out.push_back(uint8_t(got));
      } else if (command == 1 && at + 2 < in.size()) {
        const int count = in[at + 1] % 8;
        for (int n = 0; n < count; ++n) bit(in[at + 2] >> (7 - n) & 1);
        at += 2;
      } else if (command == 2) {
        chip->cs_ni = 0;
        clocks(half_clocks);
      } else if (command == 4) {
        reset();
      } else {
        chip->cs_ni = 1;
        clocks(4 * half_clocks);
      }
    }
    chip->cs_ni = 1;
    clocks(4 * half_clocks);
    for (uint16_t word : {uint16_t(chip->errors_o), uint16_t(chip->pulses_o)}) {
      out.push_back(uint8_t(word >> 8));
      out.push_back(uint8_t(word));
    }
    const uint32_t length = uint32_t(out.size());
    const uint8_t head[4] = {uint8_t(length), uint8_t(length >> 8), uint8_t(length >> 16), uint8_t(length >> 24)};
    fwrite(head, 1, 4, stdout);
    fwrite(out.data(), 1, out.size(), stdout);
    fflush(stdout);
  }
  chip.reset();  // before Verilator's own context
  return 0;
}
