#include "foten_network.h"

#include <stdatomic.h>
#include <stdlib.h>
#include <string.h>
#if defined(__x86_64__) && !defined(FOTEN_PORTABLE)
#include <cpuid.h>
#endif

/* The best first. */
static const isa *const HERE[] = {
#if defined(FOTEN_PORTABLE)
#elif defined(__x86_64__)
    &isa_avx512,
    &isa_avx2,
#elif defined(__aarch64__)
    &isa_neon,
#elif defined(__wasm_simd128__)
    &isa_simd128,
#endif
#ifndef __wasm_simd128__
    &isa_portable,
#endif
};

#if defined(__x86_64__) && !defined(FOTEN_PORTABLE)
/* The compiler's own __builtin_cpu_supports needs a table of its runtime library, which Zig's has not. */
static int runs(const isa *set) {
    enum { YMM = 0x06, ZMM = 0xE6 }; /* of XCR0: what the system saves when another program has its turn */
    unsigned eax, ebx, ecx, edx, saved, high;
    if (set == &isa_portable) return 1;
    if (!__get_cpuid(1, &eax, &ebx, &ecx, &edx) || !(ecx & bit_FMA) || !(ecx & bit_OSXSAVE)) return 0;
    __asm__("xgetbv" : "=a"(saved), "=d"(high) : "c"(0));
    if ((saved & YMM) != YMM || !__get_cpuid_count(7, 0, &eax, &ebx, &ecx, &edx)) return 0;
    if (set == &isa_avx2) return (ebx & bit_AVX2) != 0;
#ifdef __APPLE__
    saved |= ZMM; /* macOS begins to save these when a program first uses them */
#endif
    const unsigned needed = bit_AVX512F | bit_AVX512VL | bit_AVX512DQ;
    return (saved & ZMM) == ZMM && (ebx & needed) == needed;
}
#else
static int runs(const isa *set) {
    (void)set;
    return 1;
}
#endif

const isa *isa_here(void) {
    static _Atomic(const isa *) chosen;
    const isa *set = atomic_load(&chosen);
    if (set) return set;
#ifdef __wasm__
    const char *asked = NULL;
#else
    const char *asked = getenv("FOTEN_ISA");
#endif
    for (size_t i = 0; i < sizeof HERE / sizeof *HERE; i++) {
        if (!runs(HERE[i])) continue;
        if (!set) set = HERE[i];
        if (asked && !strcmp(asked, HERE[i]->name)) {
            set = HERE[i];
            break;
        }
    }
    atomic_store(&chosen, set);
    return set;
}
