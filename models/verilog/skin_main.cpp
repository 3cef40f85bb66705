// SPDX-License-Identifier: Apache-2.0
// Main program of the Verilator model: bursts of clocks until the reader ends the run.
#include "Vskin.h"
#include "verilated.h"

int main(int argc, char** argv) {
    VerilatedContext context;
    context.commandArgs(argc, argv);
    Vskin skin{&context};
    while (!context.gotFinish()) {
        skin.go_i = !skin.go_i;
        skin.eval();
    }
    skin.final();
    return 0;
}
