/* Feeds counts from a file to the robot's computer and prints what it tells the drives, row by row.
 *
 * The file is what `twin export RUN --csv --signals encoder` writes: one row per step, columns called as below. On the
 * robot the loop is the timer's, `next` reads the encoders, and the speeds go to the drives. */
#include "computer.h"

#include <errno.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

enum { LONGEST = 4096 };

static const char *const NAMES[] = {
    "encoder.count_m[0]", "encoder.count_m[1]", "encoder.count_m[2]", "encoder.count_l[0]",
    "encoder.count_l[1]", "encoder.count_l[2]", "encoder.sample",
};
enum { N_NAMES = sizeof NAMES / sizeof NAMES[0] };

/* The column of each name; false if one is missing. */
static bool found(char *heading, int columns[N_NAMES])
{
    for (int k = 0; k < N_NAMES; k++)
        columns[k] = -1;
    int column = 0;
    for (char *word = strtok(heading, ",\r\n"); word; word = strtok(NULL, ",\r\n"), column++)
        for (int k = 0; k < N_NAMES; k++)
            if (strcmp(word, NAMES[k]) == 0)
                columns[k] = column;
    for (int k = 0; k < N_NAMES; k++)
        if (columns[k] < 0) {
            fprintf(stderr, "there is no column %s\n", NAMES[k]);
            return false;
        }
    return true;
}

/* The next counts: 1. 0: the file has ended. -1: a count is no whole number. */
static int next(FILE *file, const int columns[N_NAMES], computer_counts *counts)
{
    char row[LONGEST];
    if (!fgets(row, sizeof row, file))
        return 0;
    int64_t read[N_NAMES];
    int n = 0, column = 0;
    for (const char *cell = row; cell; column++) {
        const char *end = cell + strcspn(cell, ",\r\n");
        for (int k = 0; k < N_NAMES; k++)
            if (columns[k] == column) {
                char *after;
                errno = 0;
                read[k] = strtoll(cell, &after, 10);
                if (after == cell || after != end || errno)
                    return -1;
                n++;
            }
        cell = *end == ',' ? end + 1 : NULL;
    }
    if (n < N_NAMES)
        return -1;
    for (int i = 0; i < 3; i++) {
        counts->count_m[i] = read[i];
        counts->count_l[i] = read[3 + i];
    }
    counts->sample = read[6];
    return 1;
}

int main(int n_words, char *words[])
{
    static computer it;
    char heading[LONGEST];
    int columns[N_NAMES];
    FILE *file = n_words == 2 ? fopen(words[1], "r") : NULL;
    if (!file || !fgets(heading, sizeof heading, file)) {
        fprintf(stderr, "which file of counts? %s FILE.csv\n", words[0]);
        return 2;
    }
    if (!found(heading, columns))
        return 2;

    computer_parameters parameters;
    computer_defaults(&parameters); /* and here whatever shall be another one */
    const char *wrong = computer_init(&it, &parameters);
    computer_counts counts;
    computer_output out;
    printf("t_s,omega_ref[0]_rad_per_s,omega_ref[1]_rad_per_s,omega_ref[2]_rad_per_s,power\n");
    int more;
    for (long k = 0; !wrong && (more = next(file, columns, &counts)); k++) {
        wrong = more < 0 ? "a count in the file is no whole number" : computer_step(&it, &counts, &out);
        if (!wrong)
            printf("%.17g,%.17g,%.17g,%.17g,%d\n", (double)k * COMPUTER_STEP_S, out.omega_ref[0], out.omega_ref[1],
                   out.omega_ref[2], out.power);
    }
    fclose(file);
    if (wrong) {
        fprintf(stderr, "%s\n", wrong);
        return 1;
    }
    return 0;
}
