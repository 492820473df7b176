#include <stdint.h>
#include <string.h>

/* The compiler would take these loops for calls of the very functions that they are. */
#define PLAINLY __attribute__((optimize("no-tree-loop-distribute-patterns")))

PLAINLY void *memcpy(void *restrict to, const void *restrict from, size_t count)
{
    uint8_t *bytes = to;
    for (const uint8_t *next = from; count--;)
        *bytes++ = *next++;
    return to;
}

PLAINLY void *memset(void *to, int byte, size_t count)
{
    for (uint8_t *bytes = to; count--;)
        *bytes++ = (uint8_t)byte;
    return to;
}
