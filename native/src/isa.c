#include "network.h"

#include <stdatomic.h>
#include <stdlib.h>
#include <string.h>

static const isa *const HERE[] = { /* the best first */
#if defined(FOTEN_PORTABLE)
#elif defined(__x86_64__)
    &isa_avx512, &isa_avx2,
#elif defined(__aarch64__)
    &isa_neon,
#elif defined(__wasm_simd128__)
    &isa_simd128,
#endif
#ifndef __wasm_simd128__
    &isa_portable,
#endif
};

static int runs(const isa *set) {
#if defined(__x86_64__) && !defined(FOTEN_PORTABLE)
    __builtin_cpu_init();
    if (set != &isa_portable && !__builtin_cpu_supports("fma")) return 0;
    if (set == &isa_avx512) return __builtin_cpu_supports("avx512f") && __builtin_cpu_supports("avx512vl") && __builtin_cpu_supports("avx512dq");
    if (set == &isa_avx2) return __builtin_cpu_supports("avx2");
#endif
    (void)set;
    return 1;
}

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
