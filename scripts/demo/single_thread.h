// SPDX-License-Identifier: Apache-2.0
// WebAssembly without threads has no std::mutex in its library, and Verilator's header names one; nothing here locks it.
#pragma once
#include <mutex>
namespace std {
struct mutex {
    void lock() {}
    void unlock() {}
    bool try_lock() { return true; }
};
}  // namespace std
