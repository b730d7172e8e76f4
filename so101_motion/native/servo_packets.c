/* Packets of the servo bus that pass in every cycle; protocol.py says how they look and what is refused, and why. */
#include "servos.h"

#define OVERHEAD 6 /* header 2, id, length, flags, checksum */

static int is_header(const uint8_t *in) { return in[0] == 0xFF && in[1] == 0xFF; }

static int is_asked(const Answers *a, int servo) { return a->at[servo] >= 0; }

/* Whether a packet whose checksum is right broke off and ends with the next one's bytes. */
static int is_cut_short(const Answers *a, const uint8_t *packet, int size) {
    for (int k = 3; k + 1 < size; k++)
        if (is_header(packet + k) && (k + 2 == size || is_asked(a, packet[k + 2]))) return 1;
    return 0;
}

static int is_answer(const Answers *a, const uint8_t *packet, int size) {
    int sum = 0;
    if (!is_asked(a, packet[2]) || packet[3] != size - 4) return 0;
    for (int k = 0; k < size; k++) sum += packet[k];
    return (sum & 0xFF) == 0xFD /* FF FF, and FF together with its checksum */ && !is_cut_short(a, packet, size);
}

/* Find the answers among the `n` bytes received since the question. */
void so101_answers_find(Answers *a, const uint8_t *in, int n) {
    const int size = a->count + OVERHEAD;
    int begin = 0, doubtful = 0; /* the servo whose answer ends with in[begin], an FF: checksum or next header */
    for (int k = 0; k < a->servos; k++) a->at[a->servo[k]] = 0;
    for (a->skipped = 0;;) {
        if (doubtful) {
            const int left = n - begin - 1;
            if (left < 1 || (left == 1 && in[begin + 1] == 0xFF)) break; /* the next byte decides */
            if (in[begin + 1] == 0xFF && in[begin + 2] != 0xFF) a->at[doubtful] = 0, a->skipped += size - 1;
            else begin++;
            doubtful = 0;
        }
        int start = begin;
        while (start + 1 < n && !is_header(in + start)) start++;
        if (start + 1 >= n && (start >= n || in[start] != 0xFF)) start = n; /* else a header may begin there */
        a->skipped += start - begin, begin = start;
        if (n - begin < size) break;
        if (!is_answer(a, in + begin, size)) {
            begin++, a->skipped++;
            continue;
        }
        a->at[in[begin + 2]] = begin + OVERHEAD - 1 + a->skip;
        begin += size;
        if (in[begin - 1] == 0xFF) begin--, doubtful = in[begin + 3 - size];
    }
    a->rest = n - begin - (doubtful != 0);
    a->found = a->faults = 0;
    for (int k = 0; k < a->servos; k++) {
        const int at = a->at[a->servo[k]];
        if (at > 0) a->found++, a->faults |= in[at - a->skip - 1];
        a->is_over = at > 0;
    }
}

/* Write the packet that sends these servos a word each, from `address` on; returns its size. */
int so101_sync_write_words(uint8_t *packet, int address, const int *servo, const int *word, int n) {
    uint8_t *at = packet, sum = 0;
    *at++ = 0xFF, *at++ = 0xFF, *at++ = 0xFE /* to all */, *at++ = 3 * n + 4, *at++ = 0x83, *at++ = address, *at++ = 2;
    for (int k = 0; k < n; k++) *at++ = servo[k], *at++ = word[k] & 0xFF, *at++ = word[k] >> 8;
    for (const uint8_t *each = packet + 2; each < at; each++) sum += *each;
    *at++ = ~sum;
    return at - packet;
}
