/* What the taxels did in a part of a window, in steps of their readings; sums are exact. */
typedef $SUM sum_t;
typedef $MOST most_t;
typedef struct {
    int n;
    uint32_t squares[$TAXELS];
    sum_t sum[$TAXELS];
    most_t most[$TAXELS];
} part_t;

